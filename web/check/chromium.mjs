// A browser for tests: headless Chromium with an empty profile, without connections of its own.

import assert from "node:assert/strict";
import { existsSync, mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { chromium } from "playwright-core";

/** Where distributions install it. The variable CHROMIUM names another. */
const PLACES = ["/usr/bin/chromium", "/usr/bin/google-chrome", "/usr/bin/chromium-browser"];
const FLAGS = [
  "--no-sandbox",
  "--disable-gpu",
  "--disable-quic",
  "--no-first-run",
  "--disable-background-networking",
  "--disable-component-update",
  "--disable-sync",
];

/**
 * Starts the browser. `close` ends it and removes its profile. `serviceWorkers` is "allow" for a page
 * that is to be kept offline.
 */
export async function launch(serviceWorkers = "block") {
  const executablePath = process.env.CHROMIUM ?? PLACES.find((place) => existsSync(place));
  if (!executablePath) {
    throw new Error(`there is no Chromium in ${PLACES.join(", ")}: CHROMIUM=... names another`);
  }
  const profile = mkdtempSync(join(tmpdir(), "page-test-"));
  const context = await chromium.launchPersistentContext(profile, {
    executablePath,
    headless: true,
    serviceWorkers,
    args: FLAGS,
  });
  const close = async () => {
    await context.close();
    rmSync(profile, { recursive: true, force: true });
  };
  return { context, close };
}

/** Runs the tests whose name contains `only`, one after the other, and prints the result of each. A
 * test gets `errors`, which must stay empty, and `ends`: what to do after it. `end` comes after all.
 */
export async function runTests(tests, only, end) {
  const chosen = Object.entries(tests).filter(([name]) => name.includes(only));
  assert.ok(chosen.length > 0, `no test has "${only}" in its name`);
  try {
    for (const [name, run] of chosen) {
      const t = { errors: [], ends: [] };
      const start = Date.now();
      try {
        const result = await run(t);
        assert.deepEqual(t.errors, [], "errors in the console");
        console.log(`ok    ${name}  (${((Date.now() - start) / 1000).toFixed(1)} s${result ? `; ${result}` : ""})`);
      } catch (error) {
        process.exitCode = 1;
        console.log(`FAIL  ${name}\n${error.stack}\n${t.errors.join("\n")}`);
      }
      for (const undo of t.ends.reverse()) {
        await undo();
      }
    }
  } finally {
    await end();
  }
}
