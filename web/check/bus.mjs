// Tests of "Real bus" in Chromium: the page on the SLCAN adapter of a simulated bus.
//
//   node check/bus.mjs DIRECTORY [--pictures docs/img] [NAME]
//
// DIRECTORY has the page; cargo's target directory is above it, with sim and the firmware. NAME
// chooses the tests that have it in their names. --pictures only takes the picture of the documents.

import assert from "node:assert/strict";
import { existsSync, readFileSync, statSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join, resolve } from "node:path";
import { launch, runTests } from "./chromium.mjs";
import { ArduPilot, Canable, Lawicel, SendsOnly } from "./dialects.mjs";
import { Board, connect } from "./fake-serial.mjs";
import { serve } from "../serve.mjs";

const [directory, ...rest] = process.argv.slice(2);
const pictures = rest.includes("--pictures") ? rest[rest.indexOf("--pictures") + 1] : null;
const only = rest.find((option) => !option.startsWith("--") && option !== pictures) ?? "";
const target = dirname(resolve(directory));
const PATIENCE_MS = Number(process.env.PATIENCE_MS ?? 60_000);
/** The first value of OUT1_TRIM, and another one. */
const [TRIM, OTHER_TRIM] = ["1500", "1444"];
/** The last ID below those of tools. */
const LAST = 125;
/** Start of the transfer CRC of GetNodeInfo, by its data type signature. */
const NODE_INFO_SEED = 0xd9a7;

const sims = ["debug", "release"].map((profile) => join(target, profile, "sim")).filter(existsSync);
assert.ok(sims.length > 0, "there is no sim: cargo build -p sim");
const sim = sims.sort((a, b) => statSync(b).mtimeMs - statSync(a).mtimeMs)[0];
const firmware = (name) => join(target, "firmware", name);
/** A node with few parameters, which are soon read. */
const DIECIMILA = ["--elf", firmware("diecimila-seeed.elf")];
const UNO = ["--board", "uno", "--shield", "seeed", "--elf", firmware("uno-seeed.elf")];

const { context, close } = await launch();
const { server, address } = await serve(directory);
const pause = (ms) => new Promise((done) => setTimeout(done, ms));

/** A page with "Real bus", connected to a simulated bus with these options of sim. */
async function open(t, options, makeBoard = (...args) => new Board(...args), first = /listens, and sends nothing/) {
  const board = await makeBoard(sim, options, ["--slcan"]).started();
  t.ends.push(() => board.end());
  const page = await context.newPage();
  t.ends.push(() => page.close());
  t.ends.push(await connect(page, board));
  page.setDefaultTimeout(PATIENCE_MS);
  await page.setViewportSize({ width: 1440, height: 1000 });
  page.on("pageerror", (error) => t.errors.push(String(error)));
  page.on("console", (message) => message.type() === "error" && t.errors.push(message.text()));
  page.on("request", (request) => {
    if (!/^(data|blob):/.test(request.url()) && !request.url().startsWith(address)) {
      t.errors.push(`a request to ${request.url()}`);
    }
  });
  await page.goto(`${address}#view=bus`);
  await page.click("#can-connect");
  await says(page, first);
  return { page, board };
}

async function until(page, what, condition) {
  for (const end = Date.now() + PATIENCE_MS; Date.now() < end; await pause(50)) {
    if (await condition()) {
      return;
    }
  }
  const shown = await page.locator("#can-status, #can-counters, #can-client, #can-updates, #can-nodes").allInnerTexts();
  assert.fail(`not within ${PATIENCE_MS / 1000} s: ${what}\nThe page says: ${shown.join(" | ")}`);
}
const has = (page, selector, pattern) =>
  until(page, `${pattern} in ${selector}`, async () => pattern.test(await page.locator(selector).innerText()));
const says = (page, pattern) => has(page, "#can-status", pattern);
const row = (page, node) => page.locator("#can-nodes tr", { has: page.getByLabel(`Node ${node}`, { exact: true }) });
const hasNode = (page, node, pattern) =>
  until(page, `node ${node} with ${pattern}`, async () => {
    const texts = await row(page, node).allInnerTexts();
    return texts.length === 1 && pattern.test(texts[0]);
  });
/** A number of the counters, 0 if it is not shown. */
const counter = async (page, what) =>
  Number(new RegExp(`(\\d+) ${what}`).exec(await page.locator("#can-counters").innerText())?.[1] ?? 0);

/** Asks for names, reads the parameters of node 120, and finds no line that is not SLCAN. */
async function speaks(page) {
  await page.click("#can-names");
  await says(page, /This page is node 126/);
  await hasNode(page, 120, /org\.dronecan\.servo168/);
  await chooseAndRead(page, 120);
  assert.equal(await counter(page, "lines of the adapter"), 0);
}

async function chooseAndRead(page, node) {
  await page.getByLabel(`Node ${node}`, { exact: true }).click();
  await page.click("#can-part-parameters");
  await page.click("#can-read");
  await has(page, "#can-client", /parameters read/);
}

/** A frame as an adapter tells it. */
const line = (id, data) => {
  const hex = (value, digits) => value.toString(16).toUpperCase().padStart(digits, "0");
  return `T${hex(id, 8)}${data.length}${data.map((byte) => hex(byte, 2)).join("")}\r`;
};
const status = (node, uptime = 0) => line(((20 << 24) | (341 << 8) | node) >>> 0, [uptime, 0, 0, 0, 0, 0, 0, 0xc0]);

/** The response of GetNodeInfo from a node with this name, to node 1. */
function nodeInfo(node, name) {
  const payload = [...new Array(41).fill(0), ...Buffer.from(name)];
  let crc = NODE_INFO_SEED;
  for (const byte of payload) {
    crc ^= byte << 8;
    for (let bit = 0; bit < 8; bit++) {
      crc = (crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1) & 0xffff;
    }
  }
  const stream = [crc & 0xff, crc >> 8, ...payload];
  const id = ((16 << 24) | (1 << 16) | (1 << 8) | (1 << 7) | node) >>> 0;
  let lines = "";
  for (let at = 0, toggle = 0; at < stream.length; at += 7, toggle ^= 0x20) {
    const tail = (at === 0 ? 0x80 : 0) | (at + 7 >= stream.length ? 0x40 : 0) | toggle;
    lines += line(id, [...stream.slice(at, at + 7), tail]);
  }
  return lines;
}

/** Lines from the adapter, beside those of the bus. */
const inject = (page, text) =>
  page.evaluate((lines) => window.fakePort.controller.enqueue(new TextEncoder().encode(lines)), text);

/** Bytes of the page's heap, without what is only waiting to be freed. */
async function heap(page) {
  const session = await context.newCDPSession(page);
  await session.send("HeapProfiler.collectGarbage");
  const { usedSize } = await session.send("Runtime.getHeapUsage");
  await session.detach();
  return usedSize;
}

/** An adapter that puts time stamps of microseconds behind frames, and returns what it is sent. */
class Chatty extends Board {
  rest = "";
  echoes = "";
  async write(bytes) {
    this.echoes += (bytes.toString().match(/T[^\r]*\r/g) ?? []).join("");
    return super.write(bytes);
  }
  read() {
    const bytes = super.read();
    if (bytes === null) {
      return null;
    }
    const lines = (this.rest + bytes.toString("latin1")).split("\r");
    this.rest = lines.pop();
    const told = lines.map((text) => `${text}\r`).join("") + this.echoes;
    this.echoes = "";
    return Buffer.from(told.replaceAll(/(T[0-9A-F]+)\r/g, "$10123ABCD\r"), "latin1");
  }
}

const tests = {
  async "the page lists the bus and sends nothing until names are asked for"(t) {
    const { page } = await open(t, [...UNO, "--autopilot", "ardupilot", "--nodes", "1"]);
    await hasNode(page, 120, /OPERATIONAL/);
    await hasNode(page, 121, /OPERATIONAL/);
    await has(page, "#can-traffic", /ArrayCommand|RawCommand/);
    await has(page, "#can-load", /^[1-9]\d*\.\d % of 1000 kbit\/s/);
    await pause(1000);
    assert.equal(await counter(page, "sent"), 0);
    // In one step: the list moves on.
    await until(page, "a command in the list", () =>
      page.evaluate(() => {
        const rows = [...document.querySelectorAll("#can-traffic button")];
        const row = rows.find(({ textContent }) => textContent.includes("ArrayCommand"));
        row?.click();
        return row !== undefined;
      }),
    );
    await has(page, "#can-meaning", /ArrayCommand/);
    await has(page, "#can-fields", /ACK\s+not known/);
    await has(page, "#can-frame-title", /^\d+\.\d{3} s, node/);
    await page.click("#can-names");
    await says(page, /This page is node 126/);
    await hasNode(page, 120, /org\.dronecan\.servo328/);
    await hasNode(page, 121, /org\.dronecan\.servo328/);
    const [log] = await Promise.all([page.waitForEvent("download"), page.click("#can-candump")]);
    const lines = readFileSync(await log.path(), "utf8").split("\n");
    assert.match(lines[0], /^\(\d+\.\d{6}\) can0 [0-9A-F]{8}#[0-9A-F]+$/);
    assert.ok(lines.length > 100, `${lines.length} lines`);
    await page.click("#can-connect");
    await says(page, /Plug the adapter in/);
  },

  async "parameters are read, set and saved, and survive a restart"(t) {
    const { page } = await open(t, [...DIECIMILA, "--autopilot", "ardupilot"]);
    await hasNode(page, 120, /OPERATIONAL/);
    await chooseAndRead(page, 120);
    const input = page.getByLabel("OUT1_TRIM", { exact: true });
    assert.equal(await input.inputValue(), TRIM);
    await input.fill("99999");
    await input.press("Enter");
    await has(page, "#can-client", /takes whole numbers/);
    await input.fill(OTHER_TRIM);
    await input.press("Enter");
    await has(page, "#can-client", /OUT1_TRIM = 1444/);
    await page.click("#can-save");
    await has(page, "#can-client", /^saved/);
    await page.click("#can-restart");
    await hasNode(page, 120, /00:00:0[0-4]/);
    await hasNode(page, 120, /OPERATIONAL/);
    await chooseAndRead(page, 120);
    assert.equal(await input.inputValue(), OTHER_TRIM);
  },

  async "parameters go to a file and come back, and what the node refuses is named"(t) {
    const { page } = await open(t, [...DIECIMILA, "--autopilot", "ardupilot"]);
    await hasNode(page, 120, /OPERATIONAL/);
    assert.ok(await page.locator("#can-to-file").isDisabled());
    await chooseAndRead(page, 120);
    const [saved] = await Promise.all([page.waitForEvent("download"), page.click("#can-to-file")]);
    assert.equal(saved.suggestedFilename(), "node-120.parm");
    const file = readFileSync(await saved.path(), "utf8");
    assert.match(file, /^# Parameters of node 120, org\.dronecan\.servo168\n(\w+ -?\d+\n)+$/);
    assert.ok(file.includes(`\nOUT1_TRIM ${TRIM}\n`));
    // As MAVProxy and Mission Planner write them; 99 kbit/s is no bit rate of the node.
    const other = `OUT1_TRIM        ${OTHER_TRIM}.000000\nCAN_BAUDRATE,99\nARMING_CHECK,1\n`;
    const give = (text) =>
      page.setInputFiles("#can-from-file", { name: "a.parm", mimeType: "", buffer: Buffer.from(text) });
    await give(other);
    await has(page, "#can-client", /from the file: 1 set, 0 were so before, 2 NOT/);
    await has(page, "#can-problems", /ARMING_CHECK is no parameter.*\n.*CAN_BAUDRATE 99 was refused: the node keeps 1000000/);
    const input = page.getByLabel("OUT1_TRIM", { exact: true });
    assert.equal(await input.inputValue(), OTHER_TRIM);
    await give(file);
    await has(page, "#can-client", /from the file: 1 set, \d+ were so before$/);
    assert.equal(await input.inputValue(), TRIM);
    await give("what is this");
    await has(page, "#can-problems", /what is no parameter of the node/);
  },

  async "a node is updated; an update whose adapter is pulled out goes on"(t) {
    const options = ["--no-autopilot", "--bootloader", firmware("boot-uno-seeed.hex"), ...UNO];
    const { page } = await open(t, options);
    await page.click("#can-names");
    await hasNode(page, 120, /OPERATIONAL/);
    await page.getByLabel("Node 120", { exact: true }).click();
    await has(page, "#can-chosen", /Node 120/);
    await page.setInputFiles("#can-file", firmware("uno-seeed.elf"));
    await has(page, "#can-update-status", /ELF/);
    await page.setInputFiles("#can-file", firmware("uno-seeed.bin"));
    await has(page, "#can-updates", /reading, \d{4,} of \d+ bytes/);
    await page.evaluate(() => window.fakePort.lose());
    await says(page, /port is gone/);
    await has(page, "#can-updates", /NOT updated: has no program now. Its bootloader waits/);
    await page.evaluate(() => window.plug());
    await says(page, /plugged in again: press Connect/);
    await page.click("#can-connect");
    await page.click("#can-names");
    await hasNode(page, 120, /SOFTWARE_UPDATE|MAINTENANCE/);
    await page.getByLabel("Node 120", { exact: true }).click();
    await hasNode(page, 120, /\d\.\d on 2\.0/);
    await page.click("#can-own");
    await has(page, "#can-updates", /Node 120: updated: runs version/);
    await hasNode(page, 120, /org\.dronecan\.servo328/);
    return page.locator("#can-updates").innerText();
  },

  async "an adapter with time stamps and echoes is read, and lines that are none are counted"(t) {
    const { page } = await open(t, [...DIECIMILA, "--autopilot", "ardupilot"], (...args) => new Chatty(...args));
    await hasNode(page, 120, /OPERATIONAL/);
    await chooseAndRead(page, 120);
    await until(page, "echoes", async () => (await counter(page, "returned")) > 10);
    await inject(page, "hello\rT12\r");
    await until(page, "two lines", async () => (await counter(page, "lines of the adapter")) === 2);
    assert.match(await page.locator("#can-status").innerText(), /This page is node 126/);
  },

  async "a flight controller with ArduPilot is an adapter"(t) {
    const { page, board } = await open(t, [...DIECIMILA, "--autopilot", "ardupilot"], (...args) => new ArduPilot(...args));
    await speaks(page);
    assert.deepEqual(board.commands.slice(0, 4), ["", "C", "S8", "L"]);
  },

  async "an adapter by Lawicel's manual, whose time stamps were left on, only listens until it is asked"(t) {
    const { page, board } = await open(t, [...DIECIMILA, "--autopilot", "ardupilot"], (...args) => new Lawicel(...args));
    await hasNode(page, 120, /OPERATIONAL/);
    assert.ok(board.listensOnly);
    await speaks(page);
    assert.ok(!board.listensOnly);
    assert.deepEqual(board.commands.slice(0, 8), ["", "C", "S8", "L", "", "C", "S8", "O"]);
    await page.click("#can-connect");
    await says(page, /Plug the adapter in/);
    await until(page, "a closed channel", async () => !board.isOpen);
  },

  async "an adapter that cannot only listen is opened when the user allows it"(t) {
    const options = [...DIECIMILA, "--autopilot", "ardupilot"];
    const { page, board } = await open(t, options, (...args) => new SendsOnly(...args), /disturbs the bus.*1000 kbit\/s/);
    await pause(2000);
    assert.ok(!board.isOpen);
    assert.ok(await page.locator("#can-names").isDisabled());
    await page.click("#can-send");
    await says(page, /The adapter acknowledges frames/);
    assert.ok(await page.locator("#can-send").isHidden());
    assert.deepEqual(board.commands, ["", "C", "S8", "L", "", "C", "S8", "O"]);
    await hasNode(page, 120, /OPERATIONAL/);
    assert.equal(await counter(page, "sent"), 0);
    await speaks(page);
  },

  async "garbage is no adapter"(t) {
    for (const text of ["\x07\xff\xfe\x80\r\x07", "$GPGGA,1\r\n$GPGSA,A\r\n$GPRMC,V\r\n"]) {
      const { page } = await open(t, [...DIECIMILA, "--no-autopilot"]);
      await page.click("#can-connect");
      await says(page, /Plug the adapter in/);
      await page.evaluate((garbage) => {
        const bytes = Uint8Array.from(garbage, (letter) => letter.charCodeAt(0));
        setInterval(() => window.fakePort.controller?.enqueue(bytes), 50);
      }, text);
      await page.click("#can-connect");
      await says(page, /not an SLCAN adapter, or its port has another baud rate/);
    }
  },

  async "another port is chosen while one is connected"(t) {
    const { page } = await open(t, [...DIECIMILA, "--autopilot", "ardupilot"]);
    await page.click("#can-other");
    await until(page, "the choice", async () => (await page.evaluate(() => window.requests)) === 2);
    await hasNode(page, 120, /OPERATIONAL/);
    assert.equal(await page.locator("#can-connect").innerText(), "Disconnect");
  },

  async "a CANable, which answers nothing and cannot listen only, works when it is asked"(t) {
    const { page } = await open(t, [...DIECIMILA, "--autopilot", "ardupilot"], (...args) => new Canable(...args));
    await says(page, /Nothing was heard.*"Ask for names" opens this one/);
    await speaks(page);
  },

  async "a node that is alone is heard, and acknowledged when the page sends"(t) {
    const { page } = await open(t, [...DIECIMILA, "--no-autopilot"]);
    await hasNode(page, 120, /OK/);
    assert.equal(await counter(page, "sent"), 0);
    await page.click("#can-names");
    await hasNode(page, 120, /org\.dronecan\.servo168/);
  },

  async "another node with the page's ID is told, and silences the page"(t) {
    const { page } = await open(t, [...DIECIMILA, "--no-autopilot"]);
    await page.click("#can-names");
    await says(page, /This page is node 126/);
    await inject(page, status(126));
    await says(page, /another node sends with node ID 126/);
    const sent = await counter(page, "sent");
    await pause(1500);
    assert.equal(await counter(page, "sent"), sent);
    await page.click("#can-names");
    await says(page, /This page is node 127/);
  },

  async "a hundred hostile nodes: their names are text, and the page stays usable"(t) {
    const { page } = await open(t, [...DIECIMILA, "--no-autopilot"]);
    await page.click("#can-names");
    await says(page, /This page is node 126/);
    const name = '<img src=x onerror="window.executed = 1">\u001b[2J';
    const hostile = Array.from({ length: LAST }, (_, at) => at + 1).filter((node) => node !== 120);
    await inject(page, hostile.map((node) => status(node) + nodeInfo(node, name + node)).join(""));
    await hasNode(page, LAST, /<img src=x onerror=.*\\x1b\[2J125/);
    const state = await page.evaluate(() => ({
      executed: window.executed,
      images: document.querySelectorAll("#view-bus img").length,
      rows: document.querySelectorAll("#can-nodes tr").length,
    }));
    assert.deepEqual(state, { executed: undefined, images: 0, rows: LAST });
    assert.ok(!(await page.locator("#can-nodes").textContent()).includes("\u001b"));
    await chooseAndRead(page, 120);
  },

  async "axe-core finds nothing, in light and dark, wide and narrow"(t) {
    const { page } = await open(t, [...DIECIMILA, "--autopilot", "ardupilot"]);
    const source = createRequire(import.meta.url).resolve("axe-core/axe.min.js");
    await page.evaluate(readFileSync(source, "utf8"));
    await hasNode(page, 120, /OPERATIONAL/);
    await chooseAndRead(page, 120);
    await page.setInputFiles("#can-file", firmware("diecimila-seeed.bin"));
    await has(page, "#can-update-status", /takes no further update over the bus/);
    await page.setInputFiles("#can-file", firmware("diecimila-seeed-remote.bin"));
    await has(page, "#can-updates", /NOT updated: .*takes no update over the bus/);
    for (const [colorScheme, width, part] of [["light", 1440, "bus"], ["dark", 1440, "parameters"], ["light", 360, "bus"]]) {
      await page.click(`#can-part-${part}`);
      if (part === "bus") {
        await page.locator("#can-traffic button").first().click();
      }
      await page.emulateMedia({ colorScheme });
      await page.setViewportSize({ width, height: 844 });
      const { violations } = await page.evaluate(() => globalThis.axe.run());
      const found = violations.flatMap(({ id, nodes }) =>
        nodes.map(({ target, failureSummary }) => `${id}: ${target}\n${failureSummary}`),
      );
      assert.deepEqual(found, [], `${colorScheme}, ${width} pixels`);
      const overhang = await page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
      assert.ok(overhang <= 0, `${overhang} pixels are cut off at ${width}`);
    }
  },

  async "a check that is stopped, or whose adapter is pulled, puts back what it changed"(t) {
    const { page } = await open(t, [...DIECIMILA, "--no-autopilot"]);
    await hasNode(page, 120, /OPERATIONAL/);
    await page.getByLabel("Node 120", { exact: true }).click();
    const width = async () => {
      await page.click("#can-part-parameters");
      await page.click("#can-read");
      await has(page, "#can-client", /parameters read/);
      return page.getByLabel("OUT1_FS_PWM", { exact: true }).inputValue();
    };
    await page.click("text=Check the node");
    await has(page, "#can-check-lines", /OK: Program: org\.dronecan\.servo168/);
    await has(page, "#can-check-lines", /sets OUT1_FS_PWM from 1500/);
    await page.click("text=Stop the check");
    await has(page, "#can-check-lines", /OK: Put back: OUT1_FS_PWM 1500/);
    await has(page, "#can-check-summary", /0 failed.*ended early: stopped/);
    assert.equal(await width(), "1500");
    // Of an adapter that is pulled the page keeps what is left, also when it is closed.
    await page.click("text=Check the node");
    await has(page, "#can-check-lines", /sets OUT1_FS_PWM from 1500/);
    await pause(1000);
    await page.evaluate(() => window.fakePort.lose());
    await has(page, "#can-check-summary", /the adapter is gone/);
    assert.match(await page.evaluate(() => localStorage.getItem("check-120")), /OUT1_FS_PWM":1500/);
    await page.evaluate(() => window.plug());
    await page.click("#can-connect");
    await hasNode(page, 120, /OPERATIONAL/);
    await page.getByLabel("Node 120", { exact: true }).click();
    await page.click("text=Check the node");
    await has(page, "#can-check-lines", /puts back what an earlier run has changed/);
    await has(page, "#can-check-lines", /OK: Parameters: 19/);
    await page.click("text=Stop the check");
    await has(page, "#can-check-summary", /ended early: stopped/);
    assert.equal(await width(), "1500");
  },

  async "ten thousand frames a second: memory is bounded, and the page answers"(t) {
    const { page } = await open(t, [...UNO, "--no-autopilot"]);
    await page.click("#can-names");
    await says(page, /This page is node 126/);
    await hasNode(page, 120, /OPERATIONAL/);
    /** Frames in bursts, at ten thousand a second. Returns the seconds that they took. */
    const flood = (count) =>
      page.evaluate(
        async ([text, bursts]) => {
          const burst = new TextEncoder().encode(text);
          const begin = performance.now();
          for (let sent = 0; sent < bursts; sent++) {
            await new Promise((done) => setTimeout(done, begin + sent * 10 - performance.now()));
            window.fakePort.controller.enqueue(burst);
          }
          return (performance.now() - begin) / 1000;
        },
        [Array.from({ length: 100 }, (_, n) => status((n % 100) + 1, n)).join(""), count / 100],
      );
    await flood(20_000);
    const before = await heap(page);
    const seconds = await flood(30_000);
    await until(page, "all frames", async () => (await counter(page, "frames received")) >= 50_000);
    const growth = (await heap(page)) - before;
    assert.ok(growth < 10e6, `${growth} bytes more`);
    await page.click("#can-follow");
    assert.equal(await page.locator("#can-follow").getAttribute("aria-pressed"), "false");
    await page.click("#can-connect");
    await says(page, /Plug the adapter in/);
    return `30000 frames in ${seconds.toFixed(1)} s, ${(growth / 1e6).toFixed(1)} MB more`;
  },
};

async function takePicture(t) {
  const { page } = await open(t, [...UNO, "--autopilot", "ardupilot", "--nodes", "1"]);
  await hasNode(page, 120, /OPERATIONAL/);
  await chooseAndRead(page, 120);
  await hasNode(page, 121, /org\.dronecan/);
  await page.click("#can-part-bus");
  await page.evaluate(() => document.querySelector("#can-traffic button").click());
  await page.screenshot({ path: join(pictures, "web-bus.png") });
}

await runTests(pictures ? { "the picture": takePicture } : tests, only, async () => {
  await close();
  server.close();
});
