// Tests of the page in Chromium, by keyboard and mouse as a user would.
//
//   node check/page.mjs DIRECTORY [--long] [--pictures docs/img] [NAME]
//
// --long adds the tests that take longer than a few seconds. NAME chooses those of all tests that
// have it in their names. CHROMIUM names another browser.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { cpSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { launch, runTests } from "./chromium.mjs";
import { serve } from "../serve.mjs";

const [directory, ...options] = process.argv.slice(2);
const isLong = options.includes("--long");
const pictures = options.includes("--pictures") ? options[options.indexOf("--pictures") + 1] : null;
const only = options.find((option) => !option.startsWith("--") && option !== pictures) ?? "";

/** Longest wait for a state of the page. A loaded machine simulates at a sixth of the speed or less,
 * and ten seconds of the node are a minute then. */
const PATIENCE_MS = Number(process.env.PATIENCE_MS ?? 180_000);
const { context, close } = await launch();
await context.grantPermissions(["clipboard-read", "clipboard-write"]);
const { server, address } = await serve(directory);

/** Opens the page. Fails if anything is written to the console as an error, or asks another host. */
async function open(t, { width = 1440, height = 1000, url = address } = {}) {
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE_MS);
  await page.setViewportSize({ width, height });
  page.on("console", (message) => {
    if (message.type() === "error") {
      t.errors.push(message.text());
    }
  });
  page.on("pageerror", (error) => t.errors.push(String(error)));
  page.on("request", (request) => {
    if (!/^(data:|blob:|file:)/.test(request.url()) && !request.url().startsWith(address)) {
      t.errors.push(`a request to ${request.url()}`);
    }
  });
  // Another test may have left an EEPROM.
  await page.addInitScript(() => {
    if (!sessionStorage.getItem("begun")) {
      sessionStorage.setItem("begun", "1");
      localStorage.clear();
    }
  });
  await page.goto(url);
  return page;
}

/** Angle of a servo's arm in degrees; null before its first pulse. */
const angle = (page, servo = 0) =>
  page.evaluate((index) => {
    const text = document.querySelectorAll(".arm")[index].getAttribute("transform");
    return text ? Number(/rotate\(([-\d.]+)/.exec(text)[1]) : null;
  }, servo);

/** Waits until a condition of the page holds. */
async function until(what, condition) {
  const end = Date.now() + PATIENCE_MS;
  let value;
  do {
    value = await condition();
    if (value) {
      return value;
    }
    await new Promise((done) => setTimeout(done, 50));
  } while (Date.now() < end);
  const pages = context.pages().slice(-1);
  const shown = await Promise.all(pages.map((page) => page.locator("#node, #client").allInnerTexts()));
  assert.fail(`not within ${PATIENCE_MS / 1000} s: ${what}\nThe page says: ${shown.flat().join(" ")}`);
}

const text = (page, selector) => page.locator(selector).innerText();
const setSlider = (page, selector, value, index = 0) =>
  page.locator(selector).nth(index).evaluate((input, wanted) => {
    input.value = wanted;
    input.dispatchEvent(new Event("input", { bubbles: true }));
  }, value);
const isPressed = async (page, selector) =>
  (await page.locator(selector).getAttribute("aria-pressed")) === "true";
const monitorHas = (page, what, pattern) =>
  until(what, async () => pattern.test(await page.locator("#monitor").textContent()));
const trafficHas = (page, what, pattern) =>
  until(what, async () => pattern.test(await text(page, "#traffic")));
const isRunning = (page) =>
  until("the node is operational", async () => (await text(page, "#node-text")).includes("OPERATIONAL"));
const readParameters = async (page) => {
  await page.click("#part-parameters");
  await page.click("#read");
  await until("all parameters are read", async () => /parameters read/.test(await text(page, "#client")));
};

/** The address that "Link to this" copies. */
const link = async (page) => {
  await page.click("#part-more");
  await page.click("#link");
  await until("words", async () => /restores what runs now is copied/.test(await text(page, "#notice")));
  return page.evaluate(() => navigator.clipboard.readText());
};

/** The value of a parameter, in its tab. */
const parameter = (page, name) => page.getByLabel(name, { exact: true });

/** Chooses a command in the list, in one step: the list moves on. */
const chooseCommand = (page) =>
  until("a command in the list", () =>
    page.evaluate(() => {
      const rows = [...document.querySelectorAll("#traffic button")];
      const row = rows.find(({ textContent }) => textContent.includes("ArrayCommand"));
      row?.click();
      return row !== undefined;
    }),
  );

const DIECIMILA = "Diecimila: default";

/** What the page says of each pattern. */
const PATTERNS = [
  ["px4", /^PX4, commands: unitless/],
  ["ardupilot-pwm", /^ArduPilot, commands: PWM/],
  ["plain", /^autopilot, commands: unitless/],
  ["thesis", /^autopilot of the thesis/],
  ["ardupilot", /^ArduPilot, commands: unitless/],
];

/** The sketch of docs/sketch.md as an ELF or Intel HEX file, as the Arduino IDE exports it. */
function sketch(form, ...options) {
  const directory = mkdtempSync(join(tmpdir(), "sketch-"));
  const [elf, out] = [join(directory, "sketch.elf"), join(directory, `sketch.${form}`)];
  const source = new URL("../../sim/bench/tests/avr/uno.c", import.meta.url).pathname;
  execFileSync("avr-gcc", ["-mmcu=atmega328p", "-DF_CPU=16000000UL", "-Os", ...options, source, "-o", elf]);
  if (form === "hex") {
    execFileSync("avr-objcopy", ["-O", "ihex", elf, out]);
  }
  const buffer = readFileSync(out);
  rmSync(directory, { recursive: true });
  return { name: `sketch.${form}`, mimeType: "", buffer };
}

const atRealTime = (page) =>
  until("real time", async () => Number(/([\d.]+) ×/.exec(await text(page, "#speed"))[1]) >= 0.99);

const tests = {
  async "the page loads, and the node starts and follows the autopilot"(t) {
    const page = await open(t);
    await isRunning(page);
    const first = await until("an arm", () => angle(page));
    await until("the arm moves", async () => Math.abs((await angle(page)) - first) > 5);
    assert.match(await text(page, "#monitor"), /DroneCAN servo node/);
    assert.match(await text(page, "#load"), /% of 1000 kbit\/s, 0 error frames/);
    return page;
  },

  async "a slider moves the arm"(t) {
    const page = await open(t);
    await isRunning(page);
    for (const [deflection, degrees] of [[1, 45], [-1, -45]]) {
      await setSlider(page, ".command input", deflection);
      await until(`the arm is at ${degrees} degrees`, async () => {
        return Math.abs((await angle(page)) - degrees) < 1;
      });
    }
    await page.click("#sweep");
    const slider = () => page.locator(".command input").inputValue();
    const value = await slider();
    await until("the slider shows the sweep", async () => (await slider()) !== value);
    return page;
  },

  async "a parameter is set, saved, and survives a restart"(t) {
    const page = await open(t);
    await isRunning(page);
    await readParameters(page);
    const input = parameter(page, "OUT1_TRIM");
    assert.equal(await input.inputValue(), "1500");
    await input.fill("1444");
    await input.press("Enter");
    await until("the node has taken it", async () => /OUT1_TRIM = 1444/.test(await text(page, "#client")));
    await page.click("#save");
    await until("it is saved", async () => /^saved/.test(await text(page, "#client")));
    await page.click("#restart");
    await until("it restarts", async () => (await text(page, "#monitor")).split("servo node").length > 2);
    await isRunning(page);
    await readParameters(page);
    assert.equal(await parameter(page, "OUT1_TRIM").inputValue(), "1444");
    return page;
  },

  async "saved parameters survive power off and a reload, until the EEPROM is erased"(t) {
    const page = await open(t);
    await isRunning(page);
    await readParameters(page);
    const trim = parameter(page, "OUT1_TRIM");
    await trim.fill("1444");
    await trim.press("Enter");
    await until("the node has taken it", async () => /OUT1_TRIM = 1444/.test(await text(page, "#client")));
    await page.click("#save");
    await until("it is saved", async () => /^saved/.test(await text(page, "#client")));
    for (const begin of [() => page.click("#reboot"), () => page.reload()]) {
      await new Promise((done) => setTimeout(done, 1500));
      await begin();
      await until("the parameters come by themselves", async () => (await trim.count()) === 1);
      assert.equal(await trim.inputValue(), "1444");
    }
    await page.click("#blank");
    await until("the defaults", async () => (await trim.count()) === 1 && (await trim.inputValue()) === "1500");
    return page;
  },

  async "a value that is wrong is marked, and goes back to the node's"(t) {
    const page = await open(t);
    await isRunning(page);
    await readParameters(page);
    const trim = parameter(page, "OUT1_TRIM");
    await trim.fill("9000");
    await trim.press("Enter");
    assert.equal(await trim.getAttribute("aria-invalid"), "true");
    assert.equal(await trim.inputValue(), "1500");
    assert.match(await text(page, "#client"), /OUT1_TRIM takes whole numbers from \d+ to \d+: it stays 1500/);
    const row = page.locator("#table tr", { hasText: "CAN_BAUDRATE" });
    assert.match(await row.innerText(), /bit\/s[^]*bit rate of the bus/);
    return page;
  },

  async "parameters have search, groups, marks of what is not saved, and a reset by row"(t) {
    const page = await open(t, { width: 1366, height: 768 });
    await isRunning(page);
    await readParameters(page);
    const rows = () => page.locator("#table td:nth-child(2)").filter({ visible: true }).count();
    const all = await rows();
    await page.fill("#search", "failsafe");
    const few = async () => (await rows()) > 0 && (await rows()) < all / 2;
    await until("those whose meaning has the word", few);
    await page.fill("#search", "");
    await page.selectOption("#group", "Output 1");
    const [first, last] = [parameter(page, "OUT1_TRIM"), parameter(page, "OUT2_TRIM")];
    assert.deepEqual([await first.isVisible(), await last.isVisible()], [true, false]);
    const row = page.locator("tr", { has: first });
    const { x, width } = await row.boundingBox();
    assert.ok(x >= 0 && x + width <= 1366, "no column is cut off");
    const mark = row.getByText("not saved");
    const setTo = async (value, act) => {
      await act();
      await until("the value", async () => (await first.inputValue()) === value);
      await until("the answer", async () => (await text(page, "#client")).startsWith(`OUT1_TRIM = ${value}`));
    };
    await setTo("1600", () => page.getByLabel("OUT1_TRIM, slider").fill("1600"));
    assert.equal(await mark.isVisible(), true);
    assert.match(await text(page, "#part-parameters"), /1 not saved/);
    await page.click("#save");
    await until("no mark", async () => !(await mark.isVisible()));
    await setTo("1500", () => row.getByRole("button", { name: "Reset" }).click());
    assert.equal(await mark.isVisible(), true, "the default is not what is saved");
    return page;
  },

  async "time can be slow, fast, and one frame or bit at a time"(t) {
    const page = await open(t);
    await isRunning(page);
    const factor = async () => Number(/([\d.]+) ×/.exec(await text(page, "#speed"))?.[1]);
    await page.selectOption("#rate", "0.1");
    await until("a tenth", async () => Math.abs((await factor()) - 0.1) < 0.03);
    await page.selectOption("#rate", "Infinity");
    await until("as fast as it can", async () => (await factor()) > 0.3);
    await page.click("#run");
    await until("a pause", async () => /^paused/.test(await text(page, "#speed")));
    const shown = () => page.evaluate(() => document.querySelector("#traffic").innerText);
    const before = await shown();
    // A transfer of several frames is shown with its last one.
    await until("a further transfer", async () => {
      await page.click("#step-frame");
      return (await shown()) !== before;
    });
    const clock = async () => Number(/^paused, (\d+\.\d{6}) s/.exec(await text(page, "#speed"))[1]);
    await page.click("#step-bit");
    await until("the first bit", async () => /^Bit 1 of \d+: SOF, dominant/.test(await text(page, "#bit")));
    // The clock is drawn after the bit.
    await page.waitForTimeout(500);
    const start = await clock();
    await page.click("#step-bit");
    await until("the second", async () => /^Bit 2 of/.test(await text(page, "#bit")));
    await until("a microsecond later", async () => Math.round(((await clock()) - start) * 1e6) === 1);
    await page.click("#board-title");
    assert.ok(await page.locator("#notice").isHidden(), "a heading acts on nothing");
    await page.click("#reset");
    await until("words on what waits", async () => /takes effect when you press Run/.test(await text(page, "#notice")));
    await page.click("#run");
    await until("no words", () => page.locator("#notice").isHidden());
    await link(page);
    await page.click("#run");
    await page.click("#part-bench");
    await page.locator("#first-faults button").first().click();
    assert.match(await text(page, "#notice"), /is copied/, "a pause hides no other words");
    await page.click("#run");
    assert.match(await text(page, "#notice"), /is copied/, "and neither does its end");
    await page.selectOption("#rate", "1");
    return page;
  },

  async "a fault shows and ends"(t) {
    const page = await open(t);
    await isRunning(page);
    const fault = page.locator("#fault-error-storm");
    await fault.click();
    await until("the fault is on", async () => (await fault.getAttribute("aria-pressed")) === "true");
    await until("error frames", async () => !/ 0 error frames/.test(await text(page, "#load")));
    await page.click("#end");
    await until("the fault is over", async () => (await fault.getAttribute("aria-pressed")) === "false");
    const errors = await text(page, "#load");
    const count = Number(/(\d+) error frames/.exec(errors)[1]);
    await until("time passes", async () => (await text(page, "#health")) === "OK");
    assert.ok(Number(/(\d+) error frames/.exec(await text(page, "#load"))[1]) <= count + 1);
    return page;
  },

  async "servo, faults, health, bus and the monitor's last lines are visible together"(t) {
    for (const [width, height] of [[1440, 900], [1366, 768]]) {
      const page = await open(t, { width, height });
      await isRunning(page);
      for (const part of [".output", "#first-faults", "#marks", "#health", "#timeline", "#traffic", "#plot-pulse"]) {
        const { y, height: tall } = await page.locator(part).boundingBox();
        assert.ok(y >= 0 && y + tall <= height, `${part} ends at ${y + tall} of ${height}`);
      }
      const monitor = await page.locator("#monitor").evaluate((element) => {
        const { scrollTop, clientHeight, scrollHeight } = element;
        return { bottom: element.getBoundingClientRect().bottom, unseen: scrollHeight - scrollTop - clientHeight };
      });
      assert.ok(monitor.bottom <= height && monitor.unseen < 20, JSON.stringify(monitor));
      await page.close();
    }
    return open(t);
  },

  async "on a telephone servo, command, faults and health follow each other"(t) {
    const page = await open(t, { width: 390, height: 844 });
    await isRunning(page);
    // In one step: the page goes on, and its texts get longer.
    const boxes = await page.evaluate((parts) => {
      return parts.map((part) => document.querySelector(part).getBoundingClientRect().toJSON());
    }, ["#servos", "#command", "#faults", "#node", "#health"]);
    for (const [at, { y }] of boxes.slice(1, 4).entries()) {
      const gap = y - boxes[at].y - boxes[at].height;
      assert.ok(gap >= 0 && gap < 20, `a gap of ${gap}`);
    }
    const { y, height } = boxes[4];
    assert.ok(y + height <= 844, `health ends at ${y + height}`);
    return page;
  },

  async "command, board and result are in one row, below one row of the header; on a telephone two"(t) {
    const page = await open(t, { width: 1366, height: 768 });
    const boxes = async (...parts) => Promise.all(parts.map((part) => page.locator(part).boundingBox()));
    const row = await boxes("#command", "#board", "#servos");
    row.reduce((left, right) => {
      assert.ok(left.y === right.y && left.x + left.width <= right.x, JSON.stringify(row));
      return right;
    });
    const isInRow = async (...parts) => {
      const tops = (await boxes(...parts)).map(({ y, height }) => y + height / 2);
      return Math.max(...tops) - Math.min(...tops) < 12;
    };
    assert.ok(await isInRow("h1", "#tab-simulated", "#tab-bus", "#run", "#speed", "#tour-open"));
    await page.setViewportSize({ width: 390, height: 844 });
    assert.ok(await isInRow("#tab-simulated", "#tab-board", "#tab-bus"));
    assert.ok(await isInRow("#run", "#rate", "#speed", "#tour-open"));
    const [header] = await boxes("header");
    assert.ok(header.height < 100, `the header is ${header.height} high`);
    await page.click("#run");
    assert.ok(await isInRow("#run", "#step-frame", "#step-bit", "#speed", "#tour-open"), "while it is paused");
    const [clock, tour] = await boxes("#speed", "#tour-open");
    assert.ok(clock.x + clock.width <= tour.x && tour.x + tour.width <= 390, JSON.stringify([clock, tour]));
    return page;
  },

  async "the picture has the pins of the board, its LED, and wires that are pulled and carry frames"(t) {
    const page = await open(t);
    await isRunning(page);
    const picture = page.locator("#picture");
    const pinOf = async (name) => {
      const labels = await picture.locator(".pin").allTextContents();
      return labels[labels.indexOf(name) + 1];
    };
    assert.equal(await pinOf("CS"), "D9", "of the Seeed shield");
    const buffer = readFileSync(join(directory, "../web-build/programs/uno-seeed.elf"));
    await page.setInputFiles("#file", { name: "own.elf", mimeType: "", buffer });
    await page.selectOption("#own-shield", "module");
    await until("another CS", async () => (await pinOf("CS")) === "D10");
    await page.selectOption("#program", { index: 0 });
    await isRunning(page);
    await setSlider(page, "#brightness", 1);
    const duty = () => page.locator("#light").evaluate((light) => Number(light.style.getPropertyValue("--duty")));
    await until("the LED is bright", async () => (await duty()) > 0.9);
    await until("the frame was fetched", async () => {
      await chooseCommand(page);
      return /carries fetched|fetched.*carries/.test(await picture.getAttribute("class"));
    });
    const cable = picture.locator('[data-fault="cable"]');
    await cable.focus();
    await page.keyboard.press("Enter");
    await until("the cable is pulled", () => isPressed(page, "#fault-cable"));
    await until("it is seen", async () => (await cable.getAttribute("aria-pressed")) === "true");
    assert.match(await cable.locator(".line").evaluate((line) => getComputedStyle(line).strokeDasharray), /30/);
    await cable.locator(".hit").click({ force: true });
    await until("it is in again", async () => !(await isPressed(page, "#fault-cable")));
    return page;
  },

  async "each fault of the simulator has one control, in words"(t) {
    const page = await open(t);
    const source = readFileSync(new URL("../../sim/bench/src/fault.rs", import.meta.url), "utf8");
    const names = [...source.matchAll(/^ {4}\w+ \w+ "([\w-]+)"/gm)].map(([, name]) => name);
    const buttons = await page.locator(".faults button").evaluateAll((all) =>
      all.map((button) => [button.lastChild.textContent, button.firstChild.textContent]),
    );
    // The autopilot has "Armed", and the board "Reset".
    const shown = [...buttons.map(([name]) => name), "disarm", "reset"];
    assert.deepEqual(shown.sort(), names.sort());
    for (const [name, words] of buttons) {
      assert.match(words, /^\S+( \S+)+$/, name);
    }
    return page;
  },

  async "what a fault does is marked in words, in the plots and on the time line"(t) {
    const page = await open(t);
    await isRunning(page);
    await page.selectOption("#window", "1");
    const marksHave = (pattern) =>
      until(`a mark: ${pattern}`, async () => pattern.test(await text(page, "#marks")));
    await page.click("#fault-cable");
    await marksHave(/^cable [\d.]+ s, failsafe [\d.]+ s/);
    await page.click("#run");
    for (const canvas of ["#timeline", "#plot-pulse canvas", "#plot-load canvas"]) {
      await page.click(canvas === "#plot-load canvas" ? "#part-more" : "#part-bench");
      await page.waitForTimeout(500);
      const rows = await page.locator(canvas).evaluate((element) => {
        const probe = new OffscreenCanvas(1, 1).getContext("2d");
        probe.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--error");
        probe.fillRect(0, 0, 1, 1);
        const wanted = probe.getImageData(0, 0, 1, 1).data.join();
        const { width, height } = element;
        const { data } = element.getContext("2d").getImageData(0, 0, width, height);
        const inColumn = Array(width).fill(0);
        for (let at = 0; at < data.length; at += 4) {
          inColumn[(at / 4) % width] += data.slice(at, at + 4).join() === wanted;
        }
        return Math.max(...inColumn) / height;
      });
      assert.ok(rows > 0.5, `a line in ${canvas}: ${rows} of its height`);
    }
    await page.click("#run");
    await page.click("#part-bench");
    await page.click("#end");
    await marksHave(/cable ends [\d.]+ s/);
    await marksHave(/commands again [\d.]+ s/);
    const marks = await text(page, "#marks");
    assert.equal(marks.match(/failsafe/g).length, 1, marks);
    return page;
  },

  async "the tour has six steps, points to each part, can be left and goes on where it was"(t) {
    for (const [width, height] of [[1366, 768], [390, 844]]) {
      const page = await open(t, { width, height });
      await isRunning(page);
      await page.click("#tour-open");
      for (let step = 1; step <= 6; step++) {
        assert.equal(await text(page, "#tour-title"), `Tour, step ${step} of 6`);
        const panel = await page.locator("#tour").boundingBox();
        const part = await page.locator(".toured h2, tr.toured").boundingBox();
        const free = `${JSON.stringify([panel, part])} at step ${step}`;
        assert.ok(panel.y >= 0 && part.y >= panel.y + panel.height, free);
        assert.ok(part.y + part.height <= height, free);
        if (step === 2) {
          await page.click("#previous");
          await until("the bits are on the screen", async () => {
            const bits = await page.locator("#scope").boundingBox();
            return bits && bits.y >= panel.y && bits.y + bits.height <= height + 1;
          });
        }
        if (step === 4 || step === 5) {
          await until("the cable is pulled by itself, and in again", async () => (await isPressed(page, "#fault-cable")) === (step === 4));
        }
        if (step === 5) {
          assert.match(await text(page, ".toured"), /^OUT1_TRIM/);
        }
        if (step === 3) {
          await page.keyboard.press("Escape");
          assert.equal(await page.locator("#tour, .toured").filter({ visible: true }).count(), 0);
          await page.keyboard.press("Enter");
        }
        await page.click("#tour-next");
      }
      assert.equal(await page.locator("#tour").isVisible(), false);
      await page.click("#tour-open");
      assert.equal(await text(page, "#tour-title"), "Tour, step 1 of 6");
      await page.click("#tour-leave");
      await page.close();
    }
    return open(t);
  },

  async "the page works offline after the first visit, and says that there is a new version"(t) {
    const copy = mkdtempSync(join(tmpdir(), "page-"));
    cpSync(directory, copy, { recursive: true });
    const browser = await launch("allow");
    let served = await serve(copy);
    t.ends.push(async () => {
      await browser.close();
      served.server.close();
      rmSync(copy, { recursive: true });
    });
    const stop = () => {
      served.server.close();
      served.server.closeAllConnections();
    };
    const page = await browser.context.newPage();
    await page.goto(served.address);
    await until("a worker", () =>
      page.evaluate(async () => (await navigator.serviceWorker.getRegistration())?.active?.state === "activated"),
    );
    stop();
    await page.reload();
    await isRunning(page);
    await page.click("#tab-board");
    const program = page.evaluate(async () => (await fetch(document.querySelector("#real-loader").href)).status);
    assert.equal(await program, 200, "a file for a real board");
    assert.equal(await page.locator("#new-version").isVisible(), false);
    writeFileSync(join(copy, "worker.js"), readFileSync(join(copy, "worker.js"), "utf8").replace('"page ', '"page new '));
    writeFileSync(join(copy, "index.html"), readFileSync(join(copy, "index.html"), "utf8").replace("<title>", "<title>New: "));
    served = await serve(copy, Number(new URL(served.address).port));
    await page.reload();
    await until("the offer", () => page.locator("#new-version").isVisible());
    assert.ok(!(await page.title()).startsWith("New"));
    await page.click("#use-version");
    await until("the new version", async () => (await page.title().catch(() => "")).startsWith("New"));
    return open(t);
  },

  async "nothing moves by itself for who wants less motion, and no style or script is inline"(t) {
    const page = await open(t);
    const moves = () => page.locator(".flow").evaluate((flow) => getComputedStyle(flow).animationName);
    assert.equal(await moves(), "flow");
    await page.emulateMedia({ reducedMotion: "reduce" });
    assert.equal(await moves(), "none");
    const policy = await page.locator("meta[http-equiv]").getAttribute("content");
    assert.ok(!policy.includes("unsafe-inline") && policy.startsWith("default-src 'none'"));
    const runs = await page.evaluate(() => {
      const script = document.createElement("script");
      script.textContent = "window.isInline = true";
      document.body.append(script);
      return window.isInline ?? false;
    });
    assert.equal(runs, false);
    t.errors.length = 0;
    return page;
  },

  async "the page links to its documents and licences, and each link in a document leads to its place"(t) {
    const page = await open(t);
    const footer = await page.locator("footer a").evaluateAll((all) => all.map((link) => link.href));
    assert.equal(footer.length, 3);
    const isOurs = (link) => link.startsWith(address) && link !== `${address}index.html`;
    const links = new Set(footer.filter(isOurs));
    const places = new Map();
    // The set grows while it is read.
    for (const link of links) {
      const [file] = link.split("#");
      if (places.has(file)) {
        continue;
      }
      assert.equal((await page.request.get(file)).status(), 200, file);
      places.set(file, []);
      if (file.endsWith(".html")) {
        await page.goto(file);
        const ids = page.locator("[id]");
        places.set(file, await ids.evaluateAll((all) => all.map(({ id }) => id)));
        const found = await page.locator("a, img").evaluateAll((all) => all.map(({ href, src }) => href ?? src));
        found.filter(isOurs).forEach((other) => links.add(other));
      }
    }
    for (const link of links) {
      const [file, place] = link.split("#");
      assert.ok(!place || places.get(file).includes(place), link);
    }
    assert.ok(places.size > 20, `${places.size} documents`);
    await page.goto(address);
    return page;
  },

  async "a link restores program, pattern, saved and unsaved parameters, and faults"(t) {
    const page = await open(t);
    await page.selectOption("#program", DIECIMILA);
    await isRunning(page);
    await page.selectOption("#pattern", "px4");
    await until("the parameters", async () => /parameters read/.test(await text(page, "#client")));
    const set = async (name, value) => {
      await parameter(page, name).fill(value);
      await parameter(page, name).press("Enter");
      await until("it is set", async () => (await text(page, "#client")).includes(`${name} = ${value}`));
    };
    await page.click("#part-parameters");
    await set("OUT1_TRIM", "1444");
    await page.click("#save");
    await until("it is saved", async () => /^saved/.test(await text(page, "#client")));
    await set("OUT1_MAX", "1888");
    await page.click("#part-bench");
    await page.click("#fault-cable");
    await until("the fault is on", () => isPressed(page, "#fault-cable"));
    const url = await link(page);
    await page.close();

    const other = await open(t, { url });
    assert.equal(await other.locator("#program").inputValue(), DIECIMILA);
    assert.equal(await other.locator("#pattern").inputValue(), "px4");
    await until("the fault", () => isPressed(other, "#fault-cable"));
    assert.equal(await parameter(other, "OUT1_TRIM").inputValue(), "1444");
    assert.equal(await parameter(other, "OUT1_MAX").inputValue(), "1888");
    // What is saved there lasts over a reload, and what is not saved does not; another tab has the link's.
    await other.click("#part-bench");
    await other.click("#fault-cable");
    await other.click("#part-parameters");
    await parameter(other, "OUT1_TRIM").fill("1455");
    await parameter(other, "OUT1_TRIM").press("Enter");
    await until("it is set", async () => (await text(other, "#client")).includes("OUT1_TRIM = 1455"));
    await other.click("#save");
    await until("it is saved", async () => /^saved/.test(await text(other, "#client")));
    await new Promise((done) => setTimeout(done, 1500));
    await other.reload();
    await other.click("#part-parameters");
    await until("the parameters", async () => /parameters read/.test(await text(other, "#client")));
    assert.equal(await parameter(other, "OUT1_TRIM").inputValue(), "1455");
    const third = await open(t, { url });
    await until("the fault", () => isPressed(third, "#fault-cable"));
    assert.equal(await parameter(third, "OUT1_TRIM").inputValue(), "1444");
    await third.close();
    // The program's own EEPROM is not the link's.
    await other.selectOption("#program", { index: 0 });
    await other.selectOption("#program", DIECIMILA);
    await until("the parameters", async () => (await parameter(other, "OUT1_TRIM").count()) === 1);
    assert.equal(await parameter(other, "OUT1_TRIM").inputValue(), "1500");
    return other;
  },

  async "chips at a corner make longer and shorter pulses, and a link has the corner"(t) {
    const page = await open(t);
    await isRunning(page);
    assert.equal(await text(page, "#corner-text"), "Typical values");
    const width = async () => Number.parseFloat(await page.locator(".output strong").first().innerText());
    const becomes = async (expected) => {
      await setSlider(page, ".command input", 0, 0);
      await until(`a pulse of ${expected} µs`, async () => Math.abs((await width()) - expected) < 1.5);
    };
    await becomes(1500);
    // The clock is 0.5 % slow, and 0.5 % fast.
    await page.selectOption("#corner", "slow");
    assert.match(await text(page, "#corner-text"), /clock-% -0\.5, start-ms 73, eeprom-ms 3\.74/);
    await isRunning(page);
    await becomes(1507.5);
    await page.selectOption("#corner", "fast");
    await isRunning(page);
    await becomes(1492.5);
    await page.selectOption("#corner", "random");
    const values = await text(page, "#corner-text");
    const url = await link(page);
    await page.close();
    const other = await open(t, { url });
    assert.equal(await text(other, "#corner-text"), values);
    await other.selectOption("#corner", "typical");
    assert.equal(await text(other, "#corner-text"), "Typical values");
    await isRunning(other);
    return other;
  },

  async "Back returns to the view before, where the program of a link goes on"(t) {
    const page = await open(t, { url: `${address}#program=Diecimila%3A+remote` });
    await isRunning(page);
    await page.click("#armed");
    await until("it is disarmed", async () => (await text(page, "#armed")) === "Disarmed");
    await page.click("#tab-board");
    await page.click("#tab-bus");
    await page.goBack();
    assert.equal(await page.locator("#view-board").isVisible(), true);
    await page.goBack();
    assert.equal(await page.locator("#view-simulated").isVisible(), true);
    assert.equal(await text(page, "#armed"), "Disarmed");
    // A program that was chosen since then goes on, too, until the link is opened again.
    await page.selectOption("#program", DIECIMILA);
    await page.click("#tab-board");
    await page.goBack();
    assert.equal(await page.locator("#program").inputValue(), DIECIMILA);
    await page.click("#tab-board");
    await page.goto(`${address}#program=Diecimila%3A+remote`);
    await until("its program", async () => (await page.locator("#program").inputValue()) === "Diecimila: remote");
    return page;
  },

  async "a link without a pattern has that of its program"(t) {
    const page = await open(t, { url: `${address}#program=Diecimila%3A+remote` });
    assert.equal(await page.locator("#program").inputValue(), "Diecimila: remote");
    assert.equal(await page.locator("#pattern").inputValue(), "px4");
    assert.equal(await page.locator("#notice").isVisible(), false);
    return page;
  },

  async "a link to the user's own program asks for the file"(t) {
    const page = await open(t, { url: `${address}#program=own.elf&pattern=px4` });
    await until("words", async () => /for the program own\.elf/.test(await text(page, "#notice")));
    const buffer = readFileSync(join(directory, "../web-build/programs/uno-seeed.elf"));
    await page.setInputFiles("#file", { name: "own.elf", mimeType: "", buffer });
    await until("the program", async () => (await text(page, "#wiring")).includes("Arduino Uno"));
    assert.equal(await page.locator("#pattern").inputValue(), "px4");
    return page;
  },

  async "bus, wires and serial monitor are downloaded"(t) {
    const page = await open(t);
    await isRunning(page);
    await page.click("#part-more");
    const get = async (button) => {
      const [download] = await Promise.all([page.waitForEvent("download"), page.click(button)]);
      return readFileSync(await download.path());
    };
    const lines = (await get("#candump")).toString().trim().split("\n");
    assert.ok(lines.length > 20, `${lines.length} lines`);
    lines.forEach((line) => assert.match(line, /^\(\d+\.\d{6}\) can0 [\dA-F]{8}#[\dA-F]*$/));
    const pcap = await get("#pcap");
    assert.deepEqual([pcap.readUInt32LE(0), pcap.readUInt32LE(20)], [0xa1b2c3d4, 227]);
    const vcd = (await get("#vcd")).toString();
    for (const wire of ["CAN", "CS", "SCK", "MOSI", "MISO", "INT", "TXD", "SERVO"]) {
      const [, code] = new RegExp(`\\$var wire 1 (.) ${wire} `).exec(vcd);
      const changes = vcd.split("\n").filter((line) => /^[01z].$/.test(line) && line[1] === code);
      assert.ok(changes.length > 10, `${wire} changes ${changes.length} times`);
    }
    assert.match((await get("#lines")).toString(), /DroneCAN servo node/);
    return page;
  },

  async "a script of sim plays when it is dropped, and a wrong line is named"(t) {
    const page = await open(t);
    await isRunning(page);
    const drop = async (name, content) => {
      const dataTransfer = await page.evaluateHandle(
        ([name, content]) => {
          const transfer = new DataTransfer();
          transfer.items.add(new File([content], name));
          return transfer;
        },
        [name, content],
      );
      await page.dispatchEvent("body", "drop", { dataTransfer });
    };
    await drop("a.script", "# warm\n(0.5) temperature 61\n(0.7) can0 00000A7F#55C0\n(1.2) fault cable\n");
    await until("words", async () => /a.script plays: 1 frames and 2 events/.test(await text(page, "#notice")));
    await until("the temperature", async () => /61\.0/.test(await text(page, "#sensor")));
    await until("the fault, at its time", async () => /cable 1\.2 s/.test(await text(page, "#marks")));
    await drop("b.script", "(1) jump\n");
    await until("words", async () => /b.script: line 1: expected/.test(await text(page, "#notice")));
    // What is dropped on the real bus may be an accident: it updates no node.
    await page.click("#tab-bus");
    await drop("full.bin", "a program");
    assert.match(await text(page, "#can-update-status"), /full\.bin: choose a node, and then the file with/);
    return page;
  },

  async "the sketch of docs/sketch.md runs: chip asked, hints given, board chosen"(t) {
    const page = await open(t);
    const noticed = (pattern) =>
      until(`words: ${pattern}`, async () => pattern.test(await text(page, "#notice")));
    await page.setInputFiles("#file", sketch("hex"));
    await noticed(/sketch\.hex does not say for which chip/);
    const { y, height } = await page.locator("#own").boundingBox();
    assert.ok(y > 0 && height < 100, `the choices, ${height} high, are at ${y}`);
    await page.selectOption("#own-mcu", "atmega328p");
    await noticed(/the program drives D10, CS is wired to D9(?! \()/);
    await page.getByRole("button", { name: "Wire CS to D10" }).click();
    assert.equal(await page.inputValue("#own-cs"), "D10");
    assert.match(await text(page, "#wiring"), /CS D10/);
    await page.selectOption("#own-cs", "");
    await page.selectOption("#own-shield", "module");
    assert.match(await text(page, "#wiring"), /CS D10, INT D2, crystal 8 MHz/);
    await trafficHas(page, "its frame", /123#A5/);
    await monitorHas(page, "its line", /CAN started/);
    assert.match(await text(page, "#load"), /500 kbit/);
    await page.selectOption("#own-bit_rate", "1000000");
    await noticed(/a crystal of 8 MHz does at most 500000/);
    await page.selectOption("#own-bit_rate", "250000");
    await noticed(/the node is at 500 kbit\/s, the bus at 250 kbit\/s/);
    return page;
  },

  async "the baud of the serial monitor and the text of a sketch get words"(t) {
    const page = await open(t);
    await page.setInputFiles("#file", sketch("elf", "-DUBRR=103"));
    await page.selectOption("#own-shield", "module");
    await monitorHas(page, "the hint", /the serial port has 9600 baud/);
    await page.setInputFiles("#file", { name: "a.ino", mimeType: "", buffer: Buffer.from("void setup() {}") });
    await until("words", async () => /Export compiled binary/.test(await text(page, "#notice")));
    return page;
  },

  async "numbers of any message are plotted, several at once, and the log has the nodes' messages"(t) {
    const page = await open(t);
    await isRunning(page);
    await chooseCommand(page);
    const offered = page.locator("#numbers button");
    assert.match(await offered.first().innerText(), /^Plot id 1 unitless: [-+]?\d/);
    await offered.nth(0).click();
    await offered.nth(1).click();
    assert.equal(await text(page, "#part-more"), "Log and plots (2)");
    await page.click("#part-more");
    assert.match(await text(page, "#field-place"), /10: ArrayCommand id 1 unitless[^]*id 2 unitless/);
    const inked = () =>
      page.locator("#field-place canvas").first().evaluate((canvas) => {
        const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
        const colours = new Map();
        for (let at = 0; at < data.length; at += 4) {
          const colour = data.slice(at, at + 3).join();
          colours.set(colour, (colours.get(colour) ?? 0) + (data[at + 3] > 200 ? 1 : 0));
        }
        return colours.get("11,107,203") ?? 0;
      });
    await until("a line of the field", async () => (await inked()) > 100);
    await page.getByRole("button", { name: "Remove 10: ArrayCommand id 1 unitless" }).click();
    assert.equal(await page.locator("#field-place canvas").count(), 1);
    // LogMessage of node 42: level 2, source "a", text "hot"; of node 43: level 0, text "low".
    const buffer = Buffer.from("(0.5) can0 1F3FFF2A#4161686F74C0\n(0.6) can0 1F3FFF2B#006C6F77C0\n");
    await page.setInputFiles("#file", { name: "log.script", mimeType: "", buffer });
    const lines = () => text(page, "#log-lines");
    await until("both messages", async () => /43\s+DEBUG\s+low[^]*42\s+WARNING\s+a: hot/.test(await lines()));
    await page.selectOption("#log-level", "INFO");
    await until("one message", async () => !/low/.test(await lines()) && /hot/.test(await lines()));
    const [download] = await Promise.all([page.waitForEvent("download"), page.click("#log-download")]);
    assert.match(readFileSync(await download.path(), "utf8"), /^0\.50\d 42 WARNING a: hot\n/);
    await page.fill("#log-search", "43");
    await until("no message", async () => (await lines()) === "");
    return page;
  },

  async "a frame shows its bits and the transaction that fetched it"(t) {
    const page = await open(t);
    await isRunning(page);
    await chooseCommand(page);
    assert.match(await text(page, "#frame-title"), /autopilot: .*ArrayCommand.*bits/);
    const label = await page.locator("#scope").getAttribute("aria-label");
    assert.match(label, /bits of .* stuff bits/);
    const fields = await text(page, "#fields");
    for (const name of ["SOF", "DLC", "CRC", "ACK"]) {
      assert.ok(fields.includes(name), name);
    }
    assert.match(fields, /data byte 1\s+0x[0-9a-f]{2}\s/, "numbered bytes of two digits");
    await until("the transaction", async () => {
      await chooseCommand(page);
      return /READ RX BUFFER/.test(await text(page, "#spi"));
    });
    return page;
  },

  async "the autopilot's controls do what they say"(t) {
    const page = await open(t);
    await isRunning(page);
    for (const [value, name] of PATTERNS) {
      await page.selectOption("#pattern", value);
      await until(`the pattern ${value}`, async () => name.test(await text(page, "#autopilot-text")));
    }
    await page.selectOption("#filter", "ArrayCommand");
    await page.click("#armed");
    await until("it is disarmed", async () => (await text(page, "#armed")) === "Disarmed");
    await trafficHas(page, "ArmingStatus", /ArmingStatus/);
    await page.click("#armed");
    await until("it is armed", () => isPressed(page, "#armed"));
    await page.click("#safe");
    await until("the safety switch is on", () => isPressed(page, "#safe"));
    await trafficHas(page, "SafetyState", /SafetyState/);
    await page.click("#safe");
    await setSlider(page, ".command input", 0.5);
    await until("no sweep", async () => !(await isPressed(page, "#sweep")));
    await page.click("#sweep");
    await until("a sweep", () => isPressed(page, "#sweep"));
    await page.click("#fault-silence");
    await until("the node misses commands", async () => (await text(page, "#health")) === "WARNING");
    assert.match(await text(page, "#conditions"), /(two commanders: let one node|failsafe: send commands)/);
    await page.click("#fault-silence");
    await until("the node is well again", async () => (await text(page, "#health")) === "OK");
    return page;
  },

  async "the controls of board, time and bus do what they say"(t) {
    const page = await open(t);
    await isRunning(page);
    await page.selectOption("#filter", "ArrayCommand");
    await setSlider(page, "#temperature", 61);
    await until("the sensor", async () => /61\.0/.test(await text(page, "#sensor")));
    await monitorHas(page, "the node's temperature", /temperature \+6[01]\.\d/);
    await page.fill("#text", "?");
    await page.click("#send button");
    await monitorHas(page, "the counters", /\brx \d+|lost \d+|frames/);
    await page.click("#reset");
    await monitorHas(page, "the reset", /reset: reset pin/);
    await page.click("#run");
    await until("a pause", async () => /^paused/.test(await text(page, "#speed")));
    await page.click("#previous");
    const last = await text(page, "#frame-title");
    await until("it does not follow", async () => !(await isPressed(page, "#follow")));
    await page.click("#previous");
    const before = await text(page, "#frame-title");
    assert.notEqual(before, last);
    await page.click("#next");
    assert.equal(await text(page, "#frame-title"), last);
    for (const span of ["0.01", "0.03", "1"]) {
      await page.selectOption("#window", span);
    }
    await page.click("#timeline", { position: { x: 300, y: 15 } });
    await page.click("#follow");
    await until("it follows again", () => isPressed(page, "#follow"));
    await page.click("#run");
    await until("it runs", async () => /^\d/.test(await text(page, "#speed")));
    await page.click("#reboot");
    await until("it starts anew", async () => Number.parseFloat(await text(page, "#speed")) < 2);
    return page;
  },

  async "an Uno moves eight servos, dims its light and counts presses"(t) {
    const page = await open(t);
    assert.match(await page.locator("#program").inputValue(), /^Uno/, "the first program");
    await isRunning(page);
    await page.click("#all-outputs");
    await until("it is disarmed", async () => !(await isPressed(page, "#armed")));
    await until("eight servos", async () => (await page.locator(".output").count()) === 8);
    await until("it is armed again", () => isPressed(page, "#armed"));
    for (const [servo, deflection] of [[2, 1], [7, -1]]) {
      await setSlider(page, ".command input", deflection, servo);
      await until(`the arm of servo ${servo + 1}`, async () => {
        const degrees = await angle(page, servo);
        return degrees !== null && Math.abs(degrees - 45 * deflection) < 2;
      });
    }
    await setSlider(page, "#brightness", 1);
    await until("the light", async () => (await text(page, "#light-text")) === "100 %");
    await page.selectOption("#filter", "ArrayCommand");
    await page.locator("#button").focus();
    // Each press has one message, which a slow machine may see only after others have replaced it.
    await until("the count of presses", async () => {
      await page.keyboard.down("Enter");
      const end = Date.now() + 2000;
      let isThere = false;
      while (!isThere && Date.now() < end) {
        isThere = /KeyValue.*btn/.test(await text(page, "#traffic"));
      }
      await page.keyboard.up("Enter");
      return isThere;
    });
    return page;
  },

  async "four motors turn at 400 Hz, as their sliders say, and stop when disarmed"(t) {
    const page = await open(t);
    await until("the parameters", async () => /parameters read/.test(await text(page, "#client")));
    await page.getByRole("button", { name: "Use four motors" }).click();
    await until("four motors", async () => (await page.locator(".propeller").count()) === 4);
    await until("it is armed again", () => isPressed(page, "#armed"));
    assert.equal(await parameter(page, "ESC_RATE").inputValue(), "400");
    const width = async (motor) => Number.parseFloat(await page.locator(".output strong").nth(motor).innerText());
    await setSlider(page, ".command input", 0.75, 2);
    await until("the pulse of motor 3", async () => Math.abs((await width(2)) - 1750) < 3);
    const turned = () => page.locator(".propeller").nth(2).getAttribute("transform");
    const before = await turned();
    await until("its propeller turns", async () => (await turned()) !== before);
    await trafficHas(page, "RawCommand", /RawCommand/);
    await page.click("#armed");
    await until("it stands", async () => (await width(2)) === 1000);
    return page;
  },

  async "a second node with four motors follows the same autopilot, and goes again"(t) {
    const page = await open(t);
    await isRunning(page);
    await page.click("#second");
    await until("four propellers", async () => (await page.locator("#second-outputs .propeller").count()) === 4);
    const widths = () => page.locator("#second-outputs strong").allInnerTexts();
    await until("they turn", async () => (await widths()).every((width) => /^1[1-9]\d\d\.\d µs/.test(width)));
    await setSlider(page, "#second-commands input", 0.5, 2);
    await until("the third at half power", async () => /^(149\d|150\d)\.\d µs/.test((await widths())[2]));
    await isRunning(page);
    assert.match(await text(page, "#node-text"), /node 120/);
    await trafficHas(page, "both nodes", /NodeStatus/);
    await page.click("#second");
    await until("none", async () => (await page.locator("#second-outputs .propeller").count()) === 0);
    await isRunning(page);
    return page;
  },

  async "the view of the real bus shows the simulated one, and updates its node"(t) {
    const page = await open(t);
    await isRunning(page);
    await page.click("#armed");
    await page.click("#tab-bus");
    await page.click("#can-simulated");
    await until("frames", async () => /^[1-9]\d* frames received/.test(await text(page, "#can-counters")));
    await page.click("#can-names");
    const nodes = () => text(page, "#can-nodes");
    await until("the node's name", async () => /org\.dronecan\.servo328[^\n]*OK/.test(await nodes()));
    await page.getByLabel("Node 120", { exact: true }).click();
    await page.click("#can-part-parameters");
    await page.click("#can-read");
    await until("its parameters", () => page.locator("#can-table td").count());
    await page.click("#can-own");
    await until("the bootloader reads", async () => /reading, \d{3,} of \d+ bytes/.test(await text(page, "#can-updates")));
    await until("the update's end", async () => /Node 120: (NOT )?updated/.test(await text(page, "#can-updates")));
    assert.match(await text(page, "#can-updates"), /Node 120: updated: runs version/);
    await page.click("#can-connect");
    await page.click("#tab-simulated");
    await isRunning(page);
    return page;
  },

  async "a file that is no program is refused in words, and the node goes on"(t) {
    const page = await open(t);
    await isRunning(page);
    await page.setInputFiles("#file", { name: "notes.elf", mimeType: "text/plain", buffer: Buffer.from("no ELF") });
    await until("words", async () => /notes\.elf cannot run here/.test(await text(page, "#notice")));
    await isRunning(page);
    await page.setInputFiles("#file", {
      name: "cut.hex",
      mimeType: "text/plain",
      buffer: Buffer.from(":0100000055AA\n"),
    });
    await until("words", async () => /end of the file is missing/.test(await text(page, "#notice")));
    return page;
  },

  async "the keyboard reaches every control, and the focus is visible"(t) {
    const page = await open(t);
    await isRunning(page);
    await page.click("#run");
    const wanted = await page.evaluate(() => {
      const all = [...document.querySelectorAll("a, button, select, input, summary, [tabindex='0']")];
      return all.filter((element) => element.checkVisibility() && !element.disabled).length;
    });
    const seen = new Set();
    for (let presses = 0; presses < wanted + 20 && seen.size < wanted; presses++) {
      await page.keyboard.press("Tab");
      const found = await page.evaluate(() => {
        const element = document.activeElement;
        window.reached ??= [];
        if (element === document.body) {
          return null;
        }
        if (!window.reached.includes(element)) {
          window.reached.push(element);
        }
        const { outlineStyle } = getComputedStyle(element.closest(".file") ?? element);
        return [window.reached.indexOf(element), outlineStyle];
      });
      if (found) {
        seen.add(found[0]);
        assert.notEqual(found[1], "none", "the focus is visible");
      }
    }
    assert.equal(seen.size, wanted);
    await page.reload();
    await page.keyboard.press("Tab");
    await page.keyboard.press("Enter");
    const focused = await page.evaluate(() => document.activeElement.id);
    assert.equal(focused, "timeline", "the first link leads to the bus");
    return page;
  },

  async "axe-core finds nothing, in light and dark, wide and narrow"(t) {
    const source = createRequire(import.meta.url).resolve("axe-core/axe.min.js");
    for (const [colorScheme, width] of [["light", 1440], ["dark", 1440], ["light", 360]]) {
      const page = await open(t, { width });
      await page.emulateMedia({ colorScheme });
      await isRunning(page);
      await readParameters(page);
      await page.evaluate(readFileSync(source, "utf8"));
      for (const tab of ["#part-parameters", "#part-more", "#part-bench", "#tab-board", "#tab-bus"]) {
        await page.click(tab);
        if (tab === "#part-bench") {
          await page.click("#previous");
          await page.click("#run");
        }
        const { violations } = await page.evaluate(() => globalThis.axe.run());
        const found = violations.flatMap(({ id, nodes }) =>
          nodes.map(({ target, failureSummary }) => `${id}: ${target}\n${failureSummary}`),
        );
        assert.deepEqual(found, [], `${tab}, ${colorScheme}, ${width} pixels`);
      }
      await page.close();
    }
    return open(t);
  },

  async "nothing is cut off at 360 pixels, and controls have room for a finger"(t) {
    const page = await open(t, { width: 360, height: 844 });
    await isRunning(page);
    const wide = await page.evaluate(() => {
      // The longest text of the header, that of a slow machine, whatever this one is.
      document.getElementById("speed").textContent = "1234.5 s, 0.70 ×: too slow here";
      const { scrollWidth } = document.documentElement;
      const outside = [...document.querySelectorAll("section *")].filter((element) => {
        const inScroller = element.closest(".scroll, #traffic, #monitor, .uplot");
        return !inScroller && element.getBoundingClientRect().right > window.innerWidth + 1;
      });
      return { scrollWidth, outside: outside.map((element) => element.outerHTML.slice(0, 80)) };
    });
    assert.deepEqual(wide, { scrollWidth: 360, outside: [] });
    await readParameters(page);
    for (const tab of ["#part-parameters", "#part-more", "#part-bench", "#tab-board", "#tab-bus"]) {
      await page.click(tab);
      const low = await page.evaluate(() => {
        const controls = [...document.querySelectorAll("button, select, summary, input:not([type=range], [type=checkbox], [type=file])")];
        const isLow = (control) => control.checkVisibility() && control.getBoundingClientRect().height < 32;
        return controls.filter(isLow).map((control) => control.outerHTML.slice(0, 80));
      });
      assert.deepEqual(low, [], `${tab}: lower than 32 pixels`);
    }
    return page;
  },
};

const longTests = {
  async "another node floods the bus, and the node is well again afterwards"(t) {
    const page = await open(t);
    await isRunning(page);
    await page.click("summary");
    await page.click("#fault-babble");
    await until("a full bus", async () => Number.parseFloat(await text(page, "#load")) > 80);
    await until("nobody hears the node", async () => (await text(page, "#health")) === "silent");
    await page.click("#end");
    await until("the node is well", async () => (await text(page, "#health")) === "OK");
    return page;
  },

  async "every program of the page starts"(t) {
    const page = await open(t);
    const count = await page.locator("#program option").count();
    for (let index = 0; index < count; index++) {
      await page.locator("#program").selectOption({ index });
      await until("the node is heard", async () => /OPERATIONAL/.test(await text(page, "#node-text")));
    }
    return page;
  },

  async "erased parameters are the defaults after a restart"(t) {
    const page = await open(t);
    await isRunning(page);
    await readParameters(page);
    const input = parameter(page, "OUT1_TRIM");
    await input.fill("1444");
    await input.press("Enter");
    await until("it is set", async () => /OUT1_TRIM = 1444/.test(await text(page, "#client")));
    await page.click("#save");
    await monitorHas(page, "the save", /parameters saved/);
    // An erase of an armed vehicle would stop its motors, and is refused.
    await page.click("#armed");
    await until("it is disarmed", async () => (await text(page, "#armed")) === "Disarmed");
    await monitorHas(page, "that the node knows it", /rx ArmingStatus from \d+ tid \d+: 0\b/);
    await page.click("#erase");
    await monitorHas(page, "the save of the defaults", /parameters saved[^]*parameters saved/);
    await page.click("#reset");
    await monitorHas(page, "the reset", /reset: reset pin/);
    await isRunning(page);
    await readParameters(page);
    assert.equal(await parameter(page, "OUT1_TRIM").inputValue(), "1500");
    return page;
  },

  async "every fault can begin and end, and the node is well after each"(t) {
    const page = await open(t);
    await isRunning(page);
    await page.click("summary");
    const buttons = page.locator(".faults button");
    const count = await buttons.count();
    for (let index = 0; index < count; index++) {
      const button = buttons.nth(index);
      const name = await button.innerText();
      if (name.includes("other-dialect")) {
        continue;
      }
      await button.click();
      if ((await button.getAttribute("aria-pressed")) !== null) {
        await until(`${name} begins`, async () => (await button.getAttribute("aria-pressed")) === "true");
        await page.waitForTimeout(300);
        await page.click("#end");
        await until(`${name} ends`, async () => (await button.getAttribute("aria-pressed")) === "false");
      }
      if (name.includes("brown-out")) {
        // The node reports it for a minute, or until another reset.
        await until("it is reported", async () => /after a brown-out/.test(await text(page, "#node")));
        await page.click("#reset");
      }
      await until(`well after ${name}`, async () => /^Node\s+OK/.test(await text(page, "#node")));
    }
    return page;
  },

  async "one board runs at real time with the timeline open"(t) {
    const page = await open(t);
    await isRunning(page);
    await atRealTime(page);
    return page;
  },

  async "the page works from a file"(t) {
    const page = await open(t, { url: `file://${join(process.cwd(), directory)}/index.html` });
    await isRunning(page);
    return page;
  },
};

async function takePictures(t) {
  mkdirSync(pictures, { recursive: true });
  const page = await tests["a parameter is set, saved, and survives a restart"](t);
  await page.click("#part-bench");
  await page.click("#fault-cable");
  await until("the failsafe", async () => /failsafe/.test(await text(page, "#marks")));
  await page.click("#end");
  await until("commands", async () => /commands again/.test(await text(page, "#marks")));
  await page.click("#previous");
  await page.locator("#traffic button", { hasText: "ArrayCommand" }).first().click();
  await page.waitForTimeout(3000);
  await page.setViewportSize({ width: 1440, height: 1060 });
  await page.evaluate(() => window.scrollTo(0, 0));
  await page.click("#run");
  await until("a pause", async () => /^paused/.test(await text(page, "#speed")));
  await page.screenshot({ path: join(pictures, "web.png") });
  await page.setViewportSize({ width: 390, height: 844 });
  await page.waitForTimeout(1000);
  await page.evaluate(() => window.scrollTo(0, 0));
  await page.screenshot({ path: join(pictures, "web-narrow.png") });
  await page.close();
}

/** The test, with the speed of the page that it returns as its result. All pages are closed after it. */
const ofPage = (run) => async (t) => {
  t.ends.push(async () => {
    const opened = context.pages();
    await context.newPage();
    await Promise.all(opened.map((page) => page.close()));
  });
  return text(await run(t), "#speed");
};

const inPage = Object.entries({ ...tests, ...(isLong || only ? longTests : {}) });
const all = Object.fromEntries(inPage.map(([name, run]) => [name, ofPage(run)]));
await runTests(pictures ? { "the pictures": takePictures } : all, only, async () => {
  await close();
  server.close();
});
