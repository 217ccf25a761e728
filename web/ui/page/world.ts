// What the parts of the simulated board share: the running simulation and its last state.

import type { Simulation } from "pkg/web.js";
import type { Snapshot } from "./types";

export const CYCLES_PER_MS = 16_000;

export interface World {
  readonly simulation: Simulation;
  readonly snapshot: Snapshot;
  /** Tells the user something; an empty text ends it. */
  notice(text: string, isError?: boolean): void;
}
