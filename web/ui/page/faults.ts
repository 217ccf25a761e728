// The faults of the simulator's list as buttons.

import { byId, make, setPressed } from "./dom";
import type { Fault } from "./types";

export class Faults {
  private readonly buttons = new Map<string, HTMLButtonElement>();

  constructor(faults: Fault[], inject: (name: string) => void) {
    for (const { name, text, lasts } of faults) {
      const label = text.replace(" (on/off)", "");
      const button = make("button", { type: "button" }, name, make("small", {}, label));
      button.addEventListener("click", () => inject(name));
      if (lasts) {
        setPressed(button, false);
        this.buttons.set(name, button);
      }
      byId("fault-list").append(button);
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
