// Prints how many simulated seconds the page's WebAssembly runs in a second of CPU, and what
// Chromium makes of the page with all that it draws, on one processor, as JSON: [what, numbers]
// each. For scripts/speeds.
//
//   node check/speed.mjs TARGET    TARGET is cargo's target directory, with the page

import { readFileSync } from "node:fs";
import { join, resolve } from "node:path";
import { launch } from "./chromium.mjs";
import { serve } from "../serve.mjs";

const target = resolve(process.argv[2]);
const build = join(target, "web-build");
const { Program, Simulation, initSync } = await import(join(build, "pkg/web.js"));
initSync({ module: readFileSync(join(build, "pkg/web_bg.wasm")) });

const CYCLES_PER_MS = 16_000;
/** As in the page: the length of a run, and the time between two pictures. */
const [SLICE_MS, DRAW_MS] = [4, 32];
const program = (name) => Program.parse(readFileSync(join(build, "programs", name)), "{}");

/** Simulated seconds a second of CPU, after a start of four seconds in which V8 optimises. */
function measure(name, prepare = () => {}) {
  const board = program(name);
  const simulation = new Simulation(board, new Uint8Array(), board.eeprom(), "ardupilot", "typical");
  prepare(simulation);
  let at = Math.ceil(simulation.now() / CYCLES_PER_MS / SLICE_MS) * SLICE_MS;
  const run = (ms) => {
    for (const end = at + ms; at < end; at += SLICE_MS) {
      simulation.advance((at + SLICE_MS) * CYCLES_PER_MS);
      if (at % DRAW_MS === 0) {
        simulation.snapshot();
        simulation.take_events();
      }
    }
  };
  run(4000);
  const before = process.cpuUsage();
  const measured = 8;
  run(measured * 1000);
  const { user, system } = process.cpuUsage(before);
  simulation.free();
  return (measured * 1e6) / (user + system);
}

/** The page in Chromium with all that it draws, after `prepare`: CPU seconds of its thread in a
 * second, and simulated seconds in a second. */
async function inChromium(prepare = async () => {}) {
  const { context, close } = await launch();
  const { server, address } = await serve(join(target, "web"));
  try {
    const page = await context.newPage();
    await page.setViewportSize({ width: 1440, height: 900 });
    await page.goto(`${address}#program=Uno%3A+full%2C+eight+outputs`);
    await page.waitForTimeout(8000);
    await prepare(page);
    await page.waitForTimeout(5000);
    const session = await context.newCDPSession(page);
    await session.send("Performance.enable", { timeDomain: "threadTicks" });
    const state = async () => {
      const { metrics } = await session.send("Performance.getMetrics");
      const simulated = parseFloat(await page.textContent("#speed"));
      const cpu = metrics.find((metric) => metric.name === "TaskDuration").value;
      return { cpu, simulated, at: performance.now() / 1000 };
    };
    const before = await state();
    await page.waitForTimeout(10_000);
    const after = await state();
    const perSecond = (name) => (after[name] - before[name]) / (after.at - before.at);
    return { cpu: perSecond("cpu"), simulated: perSecond("simulated") };
  } finally {
    server.close();
    await close();
  }
}

/** All eight outputs, a full bus. */
async function eightDrawn(page) {
  await page.click("#all-outputs");
  await page.waitForTimeout(15_000);
  await page.dispatchEvent("#fault-babble", "click");
}

/** A second board, a full bus. */
async function twoDrawn(page) {
  await page.click("#second");
  await page.waitForTimeout(5000);
  await page.dispatchEvent("#fault-babble", "click");
}

const rows = [
  ["a servo (Diecimila: default)", measure("diecimila-seeed.elf")],
  ["eight outputs (Uno: full)", measure("uno-seeed.elf", (page) => eight(page))],
  ["a servo node and a node of four motors", measure("uno-seeed.elf", (page) => page.add_second(program("uno-seeed.elf")))],
  ["a full bus (Uno: full)", measure("uno-seeed.elf", (page) => page.inject("babble"))],
];
const drawn = [
  ["as it opens (Uno: full)", await inChromium()],
  ["eight outputs and a full bus", await inChromium(eightDrawn)],
  ["two boards and a full bus", await inChromium(twoDrawn)],
];
console.log(JSON.stringify({ rows, drawn }));
process.exit(0);

/** Uses all outputs, as the button of the page does. */
function eight(page) {
  const run = (until) => page.advance(until * 1000 * CYCLES_PER_MS);
  run(2.5);
  page.inject("disarm");
  run(3.5);
  page.set_parameter("OUT_COUNT", 8);
  page.save_parameters();
  page.restart();
  run(8);
  page.inject("disarm");
}
