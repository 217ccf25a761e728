// Downloads: bus, wires and serial monitor of the simulated board.

import { byId, download, onClick, setPressed } from "./dom";
import type { World } from "./world";

/** Simulated time of a recording of the wires. */
const RECORDING_S = 1;

export class TakeAway {
  /** Simulated time at which the recording of the wires ends; null without one. */
  private recordedTo: number | null = null;

  /** `lines` gives those of the serial monitor. */
  constructor(
    private readonly world: World,
    lines: () => string,
  ) {
    onClick("candump", () => download("bus.log", world.simulation.candump() as BlobPart));
    onClick("pcap", () => download("bus.pcap", world.simulation.pcap() as BlobPart));
    onClick("lines", () => download("monitor.txt", lines()));
    onClick("vcd", () => {
      world.simulation.record_wires();
      this.recordedTo = world.snapshot.now + RECORDING_S;
    });
  }

  begin() {
    this.recordedTo = null;
  }

  show() {
    setPressed(byId("vcd"), this.recordedTo !== null);
    if (this.recordedTo !== null && this.world.snapshot.now >= this.recordedTo) {
      this.recordedTo = null;
      download("wires.vcd", this.world.simulation.take_wires() as BlobPart);
    }
  }
}
