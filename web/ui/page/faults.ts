// The faults of the simulator's list as buttons, in groups. A part of the page that has a button of
// its own for a fault keeps it: the autopilot "disarm", the board "reset".

import { byId, make, setPressed } from "./dom";
import type { Fault } from "./types";

/** Elements of index.html, and the faults that each has. */
const GROUPS: [string, string[]][] = [
  ["first-faults", ["cable", "error-storm", "silence", "chip-power"]],
  ["bus-faults", ["error-rate", "bit-error", "lose-frame", "no-ack", "ack-destroyed", "destroy-frames", "stuck-dominant"]],
  ["node-faults", ["babble", "wrong-rate", "same-id", "other-dialect"]],
  ["chip-faults", ["chip-reset", "chip-garbage", "chip-register", "chip-sleep", "chip-held"]],
  ["wire-faults", ["spi-noise", "miso-low", "miso-high", "int-low", "int-high"]],
  ["board-faults", ["brown-out", "sensor-noise", "sensor-short"]],
];

export class Faults {
  private readonly buttons = new Map<string, HTMLButtonElement>();

  constructor(faults: Fault[], inject: (name: string) => void) {
    for (const [group, names] of GROUPS) {
      for (const name of names) {
        const { text, lasts } = faults.find((fault) => fault.name === name)!;
        const words = text[0].toUpperCase() + text.slice(1).replace(" (on/off)", "");
        const button = make("button", { id: `fault-${name}` }, words, make("small", {}, name));
        button.addEventListener("click", () => inject(name));
        if (lasts) {
          setPressed(button, false);
          this.buttons.set(name, button);
        }
        byId(group).append(button);
      }
    }
    byId("end").addEventListener("click", () => {
      for (const [name, button] of this.buttons) {
        if (button.getAttribute("aria-pressed") === "true") {
          inject(name);
        }
      }
    });
  }

  show(active: string[]) {
    this.buttons.forEach((button, name) => setPressed(button, active.includes(name)));
  }
}
