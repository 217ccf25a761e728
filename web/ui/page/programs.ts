// The programs that the page has: those of the release, without symbols. Those that take updates over
// the bus have their bootloader.

import diecimilaLoader from "programs/boot-diecimila-seeed.hex";
import unoLoader from "programs/boot-uno-seeed.hex";
import diecimila from "programs/diecimila-seeed.elf";
import remote from "programs/diecimila-seeed-remote.elf";
import thesis from "programs/diecimila-seeed-thesis.elf";
import uno from "programs/uno-seeed.elf";

export interface Choice {
  name: string;
  bytes: Uint8Array;
  /** The bootloader of this project. */
  loader?: Uint8Array;
  autopilot: string;
  /** The choices of board.ts. */
  wiring?: string;
  /** The name under which the browser keeps the EEPROM, if it is not `name`. */
  keptAs?: string;
}

/** The program of the second board. */
export const SECOND = uno;

export const PROGRAMS: Choice[] = [
  { name: "Uno: full, eight outputs", bytes: uno, loader: unoLoader, autopilot: "ardupilot" },
  { name: "Diecimila: default", bytes: diecimila, autopilot: "ardupilot" },
  { name: "Diecimila: remote", bytes: remote, loader: diecimilaLoader, autopilot: "px4" },
  { name: "Diecimila: thesis of 2014", bytes: thesis, autopilot: "thesis" },
];

export function nameOfEeprom({ name, keptAs }: Choice) {
  return keptAs ?? name;
}
