// Prints the trace of a scenario of the cross-check in Node.js.
//
//   node run.mjs web_bg.wasm firmware.elf ardupilot|px4|thesis SECONDS SEED

import { readFileSync } from "node:fs";
import { trace } from "./trace";

const [wasm, elf, traffic, seconds, seed] = process.argv.slice(2);
const start = performance.now();
const text = trace(readFileSync(wasm), readFileSync(elf), traffic, Number(seconds), Number(seed));
const took = (performance.now() - start) / 1000;
process.stdout.write(text);
console.error(`${(Number(seconds) / took).toFixed(2)} times real time`);
