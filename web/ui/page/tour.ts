// The tour: six steps, each with the part of the page that it is about.

import { byId, onClick, setText } from "./dom";

/** What the tour does with the simulated board. */
export interface Toured {
  /** Shows the tab that has a part, and returns what to point at in it. */
  reveal(part: string): HTMLElement;
  /** Begins or ends a fault, unless it is so already. */
  setFault(name: string, isActive: boolean): void;
}

/** ID of the part, what to do there, and whether the bus cable is pulled; by default as it is. */
const STEPS: [string, string, boolean?][] = [
  ["command", "An autopilot commands a servo over a CAN bus, and the node turns each command into pulses. Drag the slider: your command replaces the autopilot's."],
  ["bus", "Each bar is a frame on the wire. Press ◀: below are its bits, and what they mean in CAN and in DroneCAN. The wires that carried it light up. Follow goes back to the present."],
  ["faults", "Pull the node's bus cable, here or in the picture. A second later, after OUT1_TIMEOUT, the failsafe begins. Red marks here and in the plots say when; OUT1_FS says what the servo does then.", false],
  ["node", "The cable is pulled: nobody hears the node. Plug it in again, and the node says how it is, and what was wrong.", true],
  ["parameters", "Set OUT1_TRIM to 1600 and press Enter: the tool on the bus asks the node, and the middle of the travel moves; a slider in its middle shows it. The value is marked until you press Save: then the node keeps it without power.", false],
  ["serial", "The node tells here what it does. Send ? for its counters: scroll up, and they stay in view. Then run a program of your own, with \"Own ELF or HEX\": Documents says how."],
];

export class Tour {
  private readonly panel = byId("tour");
  private at = 0;

  constructor(private readonly toured: Toured) {
    onClick("tour-open", () => {
      this.show(this.at);
      byId("tour-next").focus();
    });
    onClick("tour-back", () => this.show(this.at - 1));
    onClick("tour-next", () => this.show(this.at + 1));
    onClick("tour-leave", () => this.leave());
    this.panel.addEventListener("keydown", (event) => {
      if (event.key === "Escape") {
        this.leave();
      }
    });
  }

  /** Shows a step. Before the first and after the last the tour ends, and begins anew next time. */
  private show(at: number) {
    this.point(null);
    const step = STEPS[at];
    if (!step) {
      this.at = 0;
      this.leave();
      return;
    }
    this.at = at;
    const [part, text, isPulled] = step;
    this.panel.hidden = false;
    setText(byId("tour-title"), `Tour, step ${at + 1} of ${STEPS.length}`);
    setText(byId("tour-text"), text);
    setText(byId("tour-next"), at + 1 < STEPS.length ? "Next" : "End");
    if (isPulled !== undefined) {
      this.toured.setFault("cable", isPulled);
    }
    this.point(this.toured.reveal(part));
  }

  /** Leaves the tour, which goes on at this step later. */
  private leave() {
    this.panel.hidden = true;
    this.point(null);
    byId("tour-open").focus();
  }

  private point(part: HTMLElement | null) {
    document.querySelector(".toured")?.classList.remove("toured");
    part?.classList.add("toured");
    part?.scrollIntoView({ block: "nearest" });
  }
}
