// Prints the trace of a scenario of the cross-check in Chromium.
//
//   node browser.mjs web_bg.wasm firmware.elf ardupilot|px4|thesis SECONDS SEED
//
// browser.js, the bundle of browser.ts, is in the directory above that of web_bg.wasm.

import { readFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { launch } from "./chromium.mjs";

const [wasm, elf, traffic, seconds, seed] = process.argv.slice(2);
const { context, close } = await launch();
try {
  const page = await context.newPage();
  await page.addScriptTag({ path: join(dirname(wasm), "..", "browser.js") });
  const files = [wasm, elf].map((path) => readFileSync(path, "base64"));
  const text = await page.evaluate(
    ({ files, traffic, seconds, seed }) => {
      const [wasm, elf] = files.map((file) => Uint8Array.from(atob(file), (c) => c.charCodeAt(0)));
      return window.trace(wasm, elf, traffic, seconds, seed);
    },
    { files, traffic, seconds: Number(seconds), seed: Number(seed) },
  );
  await new Promise((done) => process.stdout.write(text, done));
} finally {
  await close();
}
