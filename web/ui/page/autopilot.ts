// The autopilot: its pattern, its switches, and the sliders of the outputs, which replace its
// commands. "Use all outputs" and "Use four motors" need it disarmed, and arm it again.

import { four_motors } from "pkg/web.js";
import { byId, onClick, setPressed, setText } from "./dom";
import { type Hold, Outputs } from "./outputs";
import type { Snapshot } from "./types";
import type { World } from "./world";

/** Simulated time in which the node hears that it is disarmed: ArmingStatus comes twice a second. */
const DISARM_S = 0.7;
/** Simulated time after which the node has saved and restarted, or did not accept the number. */
const RESTART_S = 10;

type Settings = [string, number][];

export class Autopilot {
  /** True while a slider holds an output. */
  private isHeld = false;
  /** What "Use all outputs" does next, and when; null when it does nothing. */
  private expand: { step: "disarm" | "arm"; at: number; settings: Settings } | null = null;
  private readonly pattern = byId<HTMLSelectElement>("pattern");
  private readonly hold: Hold = (output, motor, command) => {
    this.isHeld = true;
    if (motor === null) {
      this.world.simulation.hold(output, command);
    } else {
      this.world.simulation.hold_motor(motor, command);
    }
  };
  private readonly outputs = new Outputs(byId("outputs"), byId("commands"), this.hold);
  private readonly second = new Outputs(byId("second-outputs"), byId("second-commands"), this.hold);

  constructor(private readonly world: World) {
    this.pattern.addEventListener("change", () => world.simulation.set_autopilot(this.pattern.value));
    onClick("sweep", () => {
      this.isHeld = false;
      world.simulation.sweep();
    });
    onClick("armed", () => world.simulation.inject("disarm"));
    onClick("safe", () => world.simulation.set_safe(!world.snapshot.autopilot.safe));
    onClick("all-outputs", () => this.expandTo([["OUT_COUNT", world.snapshot.outputs.length]]));
    onClick("four-motors", () => this.expandTo(JSON.parse(four_motors())));
  }

  /** Name of the pattern that is chosen. */
  get chosen() {
    return this.pattern.value;
  }

  /** A simulation begins with this pattern. */
  begin(pattern: string) {
    this.isHeld = false;
    this.expand = null;
    this.pattern.value = pattern;
  }

  /** Arms and propellers move. */
  move({ outputs, second }: Snapshot) {
    this.outputs.show(outputs);
    this.second.show(second);
  }

  show(snapshot: Snapshot) {
    const { armed, safe, sweeps, name, command_type } = snapshot.autopilot;
    setPressed(byId("armed"), armed);
    setText(byId("armed"), armed ? "Armed" : "Disarmed");
    setPressed(byId("safe"), safe);
    setPressed(byId("sweep"), sweeps && !this.isHeld);
    setText(byId("autopilot-text"), `${name}, commands: ${command_type}`);
    this.showAllOutputs(snapshot);
  }

  private expandTo(settings: Settings) {
    const { simulation, snapshot } = this.world;
    if (snapshot.autopilot.armed) {
      simulation.inject("disarm");
    }
    this.expand = { step: "disarm", at: snapshot.now + DISARM_S, settings };
  }

  /** The node accepts another number of outputs only while the vehicle is disarmed. */
  private showAllOutputs({ now, outputs, autopilot, client }: Snapshot) {
    const { simulation } = this.world;
    const used = outputs.filter((output) => output.width_us !== null).length;
    const isOffered = outputs.length > 1 && used === 1 && this.expand === null;
    byId("all-outputs").hidden = !isOffered;
    byId("four-motors").hidden = !isOffered || !client.parameters.some(({ name }) => name === "ESC_RATE");
    if (this.expand?.step === "disarm" && now >= this.expand.at) {
      this.expand.settings.forEach(([name, value]) => simulation.set_parameter(name, value));
      simulation.save_parameters();
      simulation.restart();
      this.expand = { ...this.expand, step: "arm", at: now + RESTART_S };
    } else if (this.expand?.step === "arm" && (used > 1 || now >= this.expand.at)) {
      this.expand = null;
      if (!autopilot.armed) {
        simulation.inject("disarm");
      }
    }
  }
}
