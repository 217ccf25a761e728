// Runs a scenario of the cross-check (web/src/scenario.rs) on the page's processor.

import { Program, cross_check, initSync } from "pkg/web.js";

/** Returns the trace of a program, given as an ELF file. */
export function trace(
  wasm: Uint8Array<ArrayBuffer>,
  elf: Uint8Array,
  traffic: string,
  seconds: number,
  seed: number,
): string {
  initSync({ module: wasm });
  return cross_check(Program.parse(elf, "{}"), traffic, seconds, seed);
}
