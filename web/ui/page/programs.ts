// The programs that the page has: those of the release, without symbols.

import diecimila from "programs/diecimila-seeed.elf";
import remote from "programs/diecimila-seeed-remote.elf";
import thesis from "programs/diecimila-seeed-thesis.elf";
import motors from "programs/uno-seeed-escs.elf";
import uno from "programs/uno-seeed.elf";

export interface Choice {
  name: string;
  bytes: Uint8Array;
  autopilot: string;
  /** The choices of board.ts. */
  wiring?: string;
  /** The name under which the browser keeps the EEPROM, if it is not `name`. */
  keptAs?: string;
}

export const PROGRAMS: Choice[] = [
  { name: "Uno: full, eight outputs", bytes: uno, autopilot: "ardupilot" },
  { name: "Uno: four motors at 400 Hz", bytes: motors, autopilot: "ardupilot" },
  { name: "Diecimila: default", bytes: diecimila, autopilot: "ardupilot" },
  { name: "Diecimila: remote", bytes: remote, autopilot: "px4" },
  { name: "Diecimila: thesis of 2014", bytes: thesis, autopilot: "thesis" },
];

export function nameOfEeprom({ name, keptAs }: Choice) {
  return keptAs ?? name;
}
