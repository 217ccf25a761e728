// Tests of "Your board" in Chromium: the page flashes simulated boards through bootloaders.
//
//   node check/board.mjs DIRECTORY [--pictures docs/img] [NAME]
//
// DIRECTORY has the page; cargo's target directory is above it, with sim and the firmware. NAME
// chooses the tests that have it in their names. --pictures only takes the picture of the documents.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { existsSync, readFileSync, statSync } from "node:fs";
import { createRequire } from "node:module";
import { basename, dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { launch, runTests } from "./chromium.mjs";
import { Board, connect, fake } from "./fake-serial.mjs";
import { serve } from "../serve.mjs";

const [directory, ...options] = process.argv.slice(2);
const pictures = options.includes("--pictures") ? options[options.indexOf("--pictures") + 1] : null;
const only = options.find((option) => !option.startsWith("--") && option !== pictures) ?? "";
const target = dirname(resolve(directory));
const PATIENCE_MS = Number(process.env.PATIENCE_MS ?? 120_000);
/** Longer than any bootloader waits until it starts a program, and a program until its first line. */
const SILENCE_MS = 4000;
/** Debian's arduino-core-avr. */
const ARDUINO = "/usr/share/arduino/hardware/arduino/avr/bootloaders";
const DIECIMILA = `${ARDUINO}/atmega/ATmegaBOOT_168_diecimila.hex`;
const NANO = `${ARDUINO}/atmega/ATmegaBOOT_168_atmega328.hex`;

const sims = ["debug", "release"].map((profile) => join(target, profile, "sim")).filter(existsSync);
assert.ok(sims.length > 0, "there is no sim: cargo build -p sim");
const sim = sims.sort((a, b) => statSync(b).mtimeMs - statSync(a).mtimeMs)[0];
const elf = (name) => join(target, "firmware", name);

/** Optiboot of the Uno. */
const OPTIBOOT = execFileSync(fileURLToPath(new URL("../../scripts/optiboot", import.meta.url)), { encoding: "utf8" }).trim();

const { context, close } = await launch();
const { server, address } = await serve(directory);
await context.grantPermissions(["clipboard-read", "clipboard-write"]);

const pause = (ms) => new Promise((done) => setTimeout(done, ms));

/** A page with "Your board" on a simulated board with these options of sim. */
async function open(t, options, choice = {}) {
  const board = await new Board(sim, options).started();
  t.ends.push(() => board.end());
  const page = await context.newPage();
  t.ends.push(() => page.close());
  t.ends.push(await connect(page, board));
  page.setDefaultTimeout(PATIENCE_MS);
  await page.setViewportSize({ width: 1366, height: 900 });
  page.on("pageerror", (error) => t.errors.push(String(error)));
  page.on("console", (message) => message.type() === "error" && t.errors.push(message.text()));
  page.on("request", (request) => {
    if (!/^(data|blob):/.test(request.url()) && !request.url().startsWith(address)) {
      t.errors.push(`a request to ${request.url()}`);
    }
  });
  await page.goto(`${address}#view=board`);
  await choose(page, { board: "uno", shield: "seeed", ...choice });
  return { page, board };
}

async function choose(page, { board, shield, preset }) {
  await page.selectOption("#real-board", board);
  await page.selectOption("#real-shield", shield);
  if (preset) {
    await page.selectOption("#real-preset", preset);
  }
}

async function until(page, what, condition) {
  for (const end = Date.now() + PATIENCE_MS; Date.now() < end; await pause(50)) {
    if (await condition()) {
      return;
    }
  }
  const shown = await page.locator("#real-status, #real-monitor").allInnerTexts();
  assert.fail(`not within ${PATIENCE_MS / 1000} s: ${what}\nThe page says: ${shown.join(" ").slice(0, 500)}`);
}
const status = (page) => page.locator("#real-status").innerText();
const monitor = (page) => page.locator("#real-monitor").textContent();
const says = (page, pattern) => until(page, String(pattern), async () => pattern.test(await status(page)));
const prints = (page, pattern) => until(page, `${pattern} on the monitor`, async () => pattern.test(await monitor(page)));

/** Plugs the board in again. */
const plug = (page) => page.evaluate(() => window.plug());

/** Flashes, and waits for the end and for the node's first line. */
async function flash(page) {
  await page.click("#real-clear");
  await page.click("#real-flash");
  await says(page, /Writing.*, \d+ %, \d+ s left/);
  await says(page, /The board has the new program, and it was read back/);
  await prints(page, /DroneCAN servo node/);
}

const own = (name, text) => ({ name, mimeType: "", buffer: Buffer.from(text) });

const tests = {
  async "a Diecimila is flashed through its own bootloader, and its monitor shows the node"(t) {
    const { page } = await open(t, ["--bootloader", DIECIMILA, "--no-program"], { board: "diecimila", preset: "default" });
    await flash(page);
    await page.click("#real-clear");
    await page.fill("#real-text", "?");
    assert.equal(await page.locator("#real-status").getAttribute("class"), "done");
    assert.equal(await page.locator("#real-next").isVisible(), true);
    await page.keyboard.press("Enter");
    await until(page, "an answer", async () => (await monitor(page)).length > 20);
    await page.click("#real-copy");
    await says(page, /are copied/);
    assert.match(await page.evaluate(() => navigator.clipboard.readText()), /\w/);
    await page.click("#real-report");
    await says(page, /report is copied/);
    const report = await page.evaluate(() => navigator.clipboard.readText());
    assert.match(report, /Arduino Diecimila \(ATmega168\), Seeed CAN-BUS[^]*\d+ bytes, [\d.]+ s: complete[^]*Chrome/);
    const [file] = await Promise.all([page.waitForEvent("download"), page.click("#real-download")]);
    assert.match(readFileSync(await file.path(), "utf8"), /\w/);
    return status(page);
  },

  async "an Uno is flashed through Optiboot, and then with a file of the user"(t) {
    const options = ["--board", "uno", "--shield", "seeed", "--bootloader", OPTIBOOT, "--no-program"];
    const { page } = await open(t, options);
    await flash(page);
    await page.evaluate((text) => {
      const files = new DataTransfer();
      const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
      files.items.add(new File([bytes], "own.elf"));
      document.dispatchEvent(new DragEvent("drop", { dataTransfer: files, cancelable: true }));
    }, readFileSync(elf("uno-seeed.elf"), "base64"));
    await until(page, "the file is chosen", async () => (await page.locator("#real-preset").inputValue()) === "");
    await flash(page);
    return status(page);
  },

  async "an old Nano is flashed, also when the new one was chosen first"(t) {
    const options = ["--board", "nano", "--shield", "seeed", "--bootloader", NANO, "--no-program"];
    const { page } = await open(t, options, { board: "nano-new" });
    await page.click("#real-flash");
    await says(page, /answers at 57600 baud.*Arduino Nano, old bootloader/);
    await choose(page, { board: "nano", shield: "seeed" });
    await flash(page);
  },

  async "an Uno is flashed through the loader of this project"(t) {
    const loader = elf("boot-uno-seeed.hex");
    const { page } = await open(t, ["--board", "uno", "--shield", "seeed", "--bootloader", loader, "--no-program"]);
    await flash(page);
  },

  async "another Arduino than the one that is chosen is named, and keeps its program"(t) {
    const { page } = await open(t, ["--bootloader", DIECIMILA, "--elf", elf("diecimila-seeed.elf")]);
    await page.click("#real-flash");
    await says(page, /answers at 19200 baud.*Choose Arduino Diecimila.*Nothing was written/);
    await page.click("#real-connect");
    await prints(page, /DroneCAN servo node/);
  },

  async "an upload that is cut leaves a board that does nothing, and the next one works"(t) {
    const options = ["--board", "uno", "--shield", "seeed", "--bootloader", OPTIBOOT, "--elf", elf("uno-seeed.elf")];
    const { page, board } = await open(t, options);
    await page.click("#real-connect");
    await prints(page, /DroneCAN servo node/);
    for (const bytes of [2000, 15_000, 30_500]) {
      [board.written, board.passing] = [0, bytes];
      // What it said of the cut before.
      await page.evaluate(() => (document.getElementById("real-status").textContent = ""));
      await page.click("#real-flash");
      await says(page, /port is gone.*does nothing until you flash it/);
      board.passing = Infinity;
      board.close();
      await plug(page);
      await page.click("#real-clear");
      await page.click("#real-connect");
      await pause(SILENCE_MS);
      assert.equal((await monitor(page)).trim(), "", `a cut after ${bytes} bytes`);
      await page.click("#real-connect");
    }
    await flash(page);
  },

  async "a board that was unplugged is flashed at the first press when it is plugged in again"(t) {
    const options = ["--board", "uno", "--shield", "seeed", "--bootloader", OPTIBOOT, "--no-program"];
    const { page, board } = await open(t, options);
    await flash(page);
    await page.click("#real-connect");
    await until(page, "a closed port", async () => (await page.locator("#real-connect").innerText()) === "Connect");
    await page.evaluate(() => window.fakePort.lose());
    await says(page, /was unplugged/);
    assert.match(await page.locator("#real-port").innerText(), /unplugged/);
    // A press while it is unplugged asks for a port, and forgets none.
    await page.click("#real-flash");
    await says(page, /No port was chosen/);
    await plug(page);
    await says(page, /plugged in again/);
    await flash(page);
    // While the monitor is connected: the text is red until the board is back.
    await page.evaluate(() => window.fakePort.lose());
    await says(page, /The port is gone/);
    board.close();
    assert.match(await page.locator("#real-status").getAttribute("class"), /wrong/);
    await plug(page);
    await says(page, /plugged in again/);
    assert.doesNotMatch((await page.locator("#real-status").getAttribute("class")) ?? "", /wrong/);
    await flash(page);
    assert.equal(await page.evaluate(() => window.requests), 2, "the first choice, and that without a board");
    // The choice is opened, and the monitor goes on.
    await page.click("#real-other");
    await until(page, "the choice", async () => (await page.evaluate(() => window.requests)) === 3);
    assert.equal(await page.locator("#real-connect").innerText(), "Disconnect");
  },

  async "what is no bootloader gets words in the order of what is likely"(t) {
    // A program that prints, without a bootloader, at the rate of the choice.
    const { page } = await open(t, ["--board", "uno", "--shield", "seeed", "--elf", elf("uno-seeed.elf")]);
    await page.click("#real-flash");
    await says(page, /Something answers, but no bootloader at 19200, 57600 and 115200 baud.*"Another port".*reset button once.*programmer burns it/);
    assert.match(await page.locator("#real-status a").getAttribute("href"), /^https:\/\/docs\.arduino\.cc\//);
  },

  async "an upload can be cancelled, before the board answers and while it is written"(t) {
    const options = ["--board", "uno", "--shield", "seeed", "--bootloader", OPTIBOOT, "--elf", elf("uno-seeed.elf")];
    // An old Nano has another baud rate.
    const { page } = await open(t, options, { board: "nano" });
    await page.click("#real-flash");
    await says(page, /Looking for the bootloader/);
    await page.click("#real-cancel");
    await says(page, /Cancelled. The program of the board is as it was/);
    await choose(page, { board: "uno", shield: "seeed" });
    await page.click("#real-flash");
    await says(page, /Writing.*[1-9]\d? %/);
    await page.click("#real-cancel");
    await says(page, /Cancelled. The board has no program now/);
    await flash(page);
  },

  async "a port that another program has, a cable that is pulled and no choice get words"(t) {
    const { page, board } = await open(t, ["--bootloader", DIECIMILA, "--elf", elf("diecimila-seeed.elf")], { board: "diecimila" });
    await page.evaluate(() => (window.choosesNone = true));
    await page.click("#real-flash");
    await says(page, /No port was chosen/);
    await page.evaluate(() => (window.choosesNone = false));
    board.isTaken = true;
    await page.click("#real-flash");
    await says(page, /another program has it/);
    board.isTaken = false;
    await page.click("#real-connect");
    await prints(page, /DroneCAN servo node/);
    board.process.kill("SIGKILL");
    await says(page, /The port is gone/);
    assert.equal(await page.locator("#real-connect").innerText(), "Connect");
  },

  async "files that are no program, or one for another board, are refused before anything is written"(t) {
    const { page, board } = await open(t, ["--bootloader", DIECIMILA, "--elf", elf("diecimila-seeed.elf")], { board: "diecimila" });
    const files = [
      [own("notes.hex", "hello"), /notes.hex: it is no program/],
      [elf("uno-seeed.elf"), /for an ATmega328P, and the Arduino Diecimila has an ATmega168/],
      [elf("boot-diecimila-seeed.hex"), /as bootloaders do/],
      [elf("diecimila-module.bin"), /wiring of another CAN board: blue MCP2515 module/],
    ];
    for (const [file, words] of files) {
      await page.setInputFiles("#real-file", file);
      const name = typeof file === "string" ? basename(file) : file.name;
      await until(page, name, async () => (await page.locator("#real-preset").innerText()).includes(name));
      await page.click("#real-flash");
      await says(page, words);
    }
    assert.equal(board.written, 0);
  },

  async "what a board sends is text: it is bounded, and nothing of it is executed"(t) {
    const { page } = await open(t, ["--bootloader", DIECIMILA, "--elf", elf("diecimila-seeed.elf")], { board: "diecimila" });
    await page.click("#real-connect");
    await prints(page, /DroneCAN servo node/);
    const begun = Date.now();
    await page.evaluate(async () => {
      const hostile = '<img src=x onerror="window.executed = 1"> \u001b[2J\u0000 \u00ff\r\n';
      const long = new TextEncoder().encode(hostile.repeat(200) + "x".repeat(50_000));
      for (let round = 0; round < 200; round++) {
        window.fakePort.controller.enqueue(long);
        await new Promise((done) => setTimeout(done));
      }
    });
    await prints(page, /<img src=x/);
    const { executed, lines, images } = await page.evaluate(() => {
      const element = document.getElementById("real-monitor");
      return { executed: window.executed, lines: element.childNodes.length, images: element.querySelectorAll("*").length };
    });
    assert.deepEqual([executed, images], [undefined, 0]);
    assert.ok(lines <= 400, `${lines} lines`);
    assert.ok(!(await monitor(page)).includes("\u001b"));
    await page.click("#real-connect");
    await until(page, "the page answers", async () => (await page.locator("#real-connect").innerText()) === "Connect");
    return `${((Date.now() - begun) / 1000).toFixed(1)} s for 12 MB`;
  },

  async "axe-core finds nothing in the view, and nothing is cut off at 360 pixels"(t) {
    const source = createRequire(import.meta.url).resolve("axe-core/axe.min.js");
    const page = await context.newPage();
    t.ends.push(() => page.close());
    await page.addInitScript(fake);
    for (const [colorScheme, width] of [["light", 1440], ["dark", 1440], ["light", 360]]) {
      await page.emulateMedia({ colorScheme });
      await page.setViewportSize({ width, height: 900 });
      await page.goto(`${address}?${width}${colorScheme}#view=board`);
      await says(page, /Plug the board in/);
      await page.evaluate(readFileSync(source, "utf8"));
      const { violations } = await page.evaluate(() => globalThis.axe.run());
      const found = violations.flatMap(({ id, nodes }) => nodes.map(({ target }) => `${id}: ${target}`));
      assert.deepEqual(found, [], `${colorScheme}, ${width} pixels`);
    }
    const wide = await page.evaluate(() => {
      const outside = [...document.querySelectorAll("#view-board section *")].filter(
        (element) => element.getBoundingClientRect().right > window.innerWidth + 1,
      );
      return outside.map((element) => element.outerHTML.slice(0, 80));
    });
    assert.deepEqual(wide, []);
    for (const id of ["real-board", "real-flash", "real-connect", "real-text", "real-report"]) {
      await until(page, `the keyboard reaches ${id}`, async () => {
        await page.keyboard.press("Tab");
        return (await page.evaluate(() => document.activeElement.id)) === id;
      });
    }
  },

  async "the drawing of the wiring is that of the choice, and is fetched when the view is shown"(t) {
    const page = await context.newPage();
    t.ends.push(() => page.close());
    await page.addInitScript(fake);
    const fetched = [];
    page.on("request", (request) => /wiring-[^/]*\.svg$/.test(request.url()) && fetched.push(request.url().split("/").at(-1)));
    await page.goto(address);
    await until(page, "the simulated board", () => page.locator("#servos").isVisible());
    await pause(500);
    assert.deepEqual(fetched, []);
    await page.click("#tab-board");
    await choose(page, { board: "uno", shield: "seeed" });
    const isShown = () => page.evaluate(() => document.getElementById("real-picture").naturalWidth > 0);
    await until(page, "the drawing", async () => fetched.at(-1) === "wiring-seeed-atmega328p.svg" && (await isShown()));
    await choose(page, { board: "diecimila", shield: "module" });
    await until(page, "another drawing", async () => fetched.at(-1) === "wiring-module-atmega168.svg" && (await isShown()));
    await page.locator("#view-board summary").click();
    assert.match(await page.locator("#real-drawing").innerText(), /5V {2}─+ {2}VCC[^]*LM35/);
    await choose(page, { board: "uno", shield: "module" });
    assert.match(await page.locator("#real-drawing").innerText(), /A3 {2}─+ {2}servo 8/);
  },

  async "a page from a file on the disk says where programs come from"(t) {
    const page = await context.newPage();
    t.ends.push(() => page.close());
    await page.addInitScript(fake);
    await page.goto(`file://${resolve(directory)}/index.html#view=board`);
    await page.click("#real-flash");
    await says(page, /From a file on the disk the page has no programs: use https, or make web/);
  },

  async "a browser without Web Serial is told so"(t) {
    const page = await context.newPage();
    t.ends.push(() => page.close());
    await page.addInitScript(() => Reflect.deleteProperty(Navigator.prototype, "serial"));
    await page.goto(`${address}#view=board`);
    await says(page, /navigator\.serial/);
    assert.ok(await page.locator("#real-flash").isDisabled());
    await page.click("#tab-simulated");
    await until(page, "the simulated board", () => page.locator("#servos").isVisible());
  },
};

async function takePicture(t) {
  const options = ["--board", "uno", "--shield", "module", "--bootloader", OPTIBOOT, "--no-program"];
  const { page } = await open(t, options, { shield: "module" });
  await flash(page);
  await prints(page, /temperature/);
  await page.screenshot({ path: join(pictures, "web-board.png") });
}

await runTests(pictures ? { "the picture": takePicture } : tests, only, async () => {
  await close();
  server.close();
});
