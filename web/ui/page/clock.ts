// The clock of the simulation: real time, slower or faster, or a frame or a bit at a time.

import { byId, onClick, setText } from "./dom";
import { CYCLES_PER_MS, type World } from "./world";

/** Simulated time of one slice, between two looks at the clock. */
const SLICE_MS = 1;
/** Real time that the simulation may take between two pictures. */
const BUDGET_MS = 14;
/** Real time that the simulation may be behind before the page says that it cannot keep up. */
const LAG_MS = 250;
const SLOW = 0.97;
/** The longest simulated time in which "One frame" waits for a frame. */
const STEP_MS = 2000;

export class Clock {
  /** False while the time is paused. */
  isRunning = true;
  /** Real time up to which the simulation should be, less the simulated time. */
  private offset = 0;
  /** Simulated time for a unit of real time. */
  private rate = 1;
  private isBehind = false;
  private speed = { at: 0, simulated: 0, factor: 1 };
  /** Time of the bit that is marked, in seconds; null without one. */
  private bitAt: number | null = null;

  /** `showsFrame` shows the newest frame, and marks none of its bits; `nextBit` marks the next bit of
   * the chosen frame, and returns its time, or null after the last. */
  constructor(
    private readonly world: World,
    private readonly showFrame: () => void,
    private readonly nextBit: () => number | null,
  ) {
    onClick("run", () => {
      this.isRunning = !this.isRunning;
      setText(byId("run"), this.isRunning ? "Pause" : "Run");
      byId("steps").hidden = this.isRunning;
      this.bitAt = null;
      this.synchronise();
    });
    onClick("step-frame", () => this.stepFrame());
    onClick("step-bit", () => this.stepBit());
    const rate = byId<HTMLSelectElement>("rate");
    rate.addEventListener("change", () => {
      this.rate = Number(rate.value);
      this.synchronise();
    });
  }

  private get simulated() {
    return this.world.simulation.now() / CYCLES_PER_MS;
  }

  /** Real time goes on from the present simulated time. */
  synchronise() {
    const { simulated } = this;
    const at = performance.now();
    this.offset = at - simulated / this.rate;
    this.isBehind = false;
    this.speed = { at, simulated, factor: this.rate };
  }

  /** Simulates up to the present moment, as far as the budget allows. */
  run(time: number) {
    if (!this.isRunning) {
      return;
    }
    const start = performance.now();
    const wanted = this.rate === Infinity ? Infinity : (time - this.offset) * this.rate;
    let { simulated } = this;
    while (simulated < wanted && performance.now() - start < BUDGET_MS) {
      simulated += SLICE_MS;
      this.world.simulation.advance(simulated * CYCLES_PER_MS);
    }
    if (wanted - simulated > LAG_MS * this.rate) {
      // What was missed is not made up for.
      this.offset += (wanted - simulated) / this.rate;
    }
    if (time - this.speed.at > 1000) {
      const factor = (simulated - this.speed.simulated) / (time - this.speed.at);
      // One slow second is no news: the browser still compiles.
      const slow = SLOW * this.rate;
      this.isBehind = this.rate < Infinity && factor < slow && this.speed.factor < slow;
      this.speed = { at: time, simulated, factor };
    }
  }

  show() {
    const { now } = this.world.snapshot;
    const late = this.isBehind ? ": too slow here" : "";
    const running = `${now.toFixed(1)} s, ${this.speed.factor.toFixed(2)} ×${late}`;
    setText(byId("speed"), this.isRunning ? running : `paused, ${(this.bitAt ?? now).toFixed(6)} s`);
  }

  /** The next bit of the chosen frame; after its last the first one of the next frame. */
  private stepBit() {
    this.bitAt = this.nextBit();
    if (this.bitAt === null) {
      this.stepFrame();
      this.bitAt = this.nextBit();
    }
  }

  /** Simulates up to the end of the next frame on the bus. */
  private stepFrame() {
    const { simulation } = this.world;
    const frames = simulation.frames();
    const bit = (CYCLES_PER_MS * 1000) / this.world.snapshot.bit_rate;
    const end = simulation.now() + STEP_MS * CYCLES_PER_MS;
    this.bitAt = null;
    while (simulation.now() < end) {
      simulation.advance(simulation.now() + bit);
      if (simulation.frames() > frames) {
        this.showFrame();
        return;
      }
    }
    this.world.notice(`No frame came in ${STEP_MS / 1000} s.`);
  }
}
