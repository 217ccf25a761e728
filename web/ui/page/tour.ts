// The tour: six steps, each with the part of the page that it is about.

import { byId, setText } from "./dom";

/** ID of the part, and what to do there. */
const STEPS: [string, string][] = [
  ["servos", "An autopilot commands this servo over a CAN bus, and the node turns each command into pulses. Drag the slider: your command replaces the autopilot's."],
  ["bus", "Each bar is a frame on the wire. Press Previous: below are its bits, and what they mean in CAN and in DroneCAN. Follow goes back to the present."],
  ["faults", "Pull the node's bus cable. A second later, after OUT1_TIMEOUT, the failsafe begins. Red marks here and in the plots say when; OUT1_FS says what the servo does then."],
  ["node", "Nobody hears the node now. Press the fault again to plug the cable in: the node says how it is, and what was wrong."],
  ["parameters", "Set OUT1_TRIM to 1600 and press Enter: the tool on the bus asks the node, and the middle of the travel moves. Save keeps it without power."],
  ["serial", "The node tells here what it does. Send ? for its counters. Then try the Uno, or a program of your own: Documents says how."],
];

export class Tour {
  private readonly panel = byId("tour");
  private at = 0;

  constructor() {
    byId("tour-open").addEventListener("click", () => {
      this.show(this.at);
      byId("tour-next").focus();
    });
    byId("tour-back").addEventListener("click", () => this.show(this.at - 1));
    byId("tour-next").addEventListener("click", () => this.show(this.at + 1));
    byId("tour-leave").addEventListener("click", () => this.leave());
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
    const [part, text] = step;
    this.panel.hidden = false;
    setText(byId("tour-title"), `Tour, step ${at + 1} of ${STEPS.length}`);
    setText(byId("tour-text"), text);
    setText(byId("tour-next"), at + 1 < STEPS.length ? "Next" : "End");
    this.point(byId(part));
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
