// Runs a scenario of the cross-check (web/src/scenario.rs) on avr8js.

import { Program, cross_check, initSync } from "pkg/web.js";
import { Processor } from "./avr/processor";

/** Returns the trace of a program, given as an ELF file. */
export function trace(
  wasm: Uint8Array<ArrayBuffer>,
  elf: Uint8Array,
  traffic: string,
  seconds: number,
  seed: number,
): string {
  initSync({ module: wasm });
  const program = Program.parse(elf, "{}");
  const processor = new Processor(program.flash(), program.ram_bytes(), program.eeprom());
  return cross_check(program, processor, traffic, seconds, seed);
}
