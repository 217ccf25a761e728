// The SLCAN adapter on the simulated bus, as a port of the view "Real bus".

import type { Simulation } from "pkg/web.js";
import { PortError } from "./ports";

const GONE = "The simulated board was started again: connect again.";

export class SimulatedPort {
  readonly losses = { dropped: 0, broken: 0 };
  private used: Simulation | null = null;

  /** `simulation` gives the running one. */
  constructor(private readonly simulation: () => Simulation) {}

  /** Bits per second of its bus. */
  get bitRate() {
    return this.simulation().bit_rate();
  }

  async open(_baudRate: number, _owner: string) {
    this.used = this.simulation();
    this.used.read_adapter();
  }

  async close() {
    this.used = null;
  }

  /** Bytes of the adapter; waits for `waitMs` if there are none. */
  async read(waitMs: number): Promise<Uint8Array> {
    const bytes = this.running().read_adapter();
    if (bytes.length === 0) {
      await new Promise((done) => setTimeout(done, waitMs));
    }
    return bytes;
  }

  async write(bytes: Uint8Array) {
    this.running().write_adapter(bytes);
  }

  private running() {
    if (this.used === null || this.used !== this.simulation()) {
      throw new PortError("unplugged", GONE);
    }
    return this.used;
  }
}
