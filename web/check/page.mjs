// Tests of the page in Chromium, by keyboard and mouse as a user would.
//
//   node check/page.mjs DIRECTORY [--long] [--pictures docs/img] [NAME]
//
// --long adds the tests that take longer than a few seconds. NAME chooses those of all tests that
// have it in their names. CHROMIUM names another browser.

import assert from "node:assert/strict";
import { mkdirSync } from "node:fs";
import { join } from "node:path";
import { launch } from "./chromium.mjs";
import { serve } from "../serve.mjs";

const [directory, ...options] = process.argv.slice(2);
const isLong = options.includes("--long");
const pictures = options.includes("--pictures") ? options[options.indexOf("--pictures") + 1] : null;
const only = options.find((option) => !option.startsWith("--") && option !== pictures);

/** Longest wait for a state of the page. A loaded machine simulates slowly. */
const PATIENCE_MS = Number(process.env.PATIENCE_MS ?? 60_000);
const { context, close } = await launch();
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
  await page.click("#read");
  await until("all parameters are read", async () => /parameters read/.test(await text(page, "#client")));
};

/** What the page says of each pattern. */
const PATTERNS = [
  ["px4", /^PX4, commands: unitless/],
  ["ardupilot-pwm", /^ArduPilot, commands: PWM/],
  ["plain", /^autopilot, commands: unitless/],
  ["thesis", /^autopilot of the thesis/],
  ["ardupilot", /^ArduPilot, commands: unitless/],
];

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
      await setSlider(page, ".output input", deflection);
      await until(`the arm is at ${degrees} degrees`, async () => {
        return Math.abs((await angle(page)) - degrees) < 1;
      });
    }
    return page;
  },

  async "a parameter is set, saved, and survives a restart"(t) {
    const page = await open(t);
    await isRunning(page);
    await readParameters(page);
    const input = page.getByLabel("OUT1_TRIM");
    assert.equal(await input.inputValue(), "1500");
    await input.fill("1444");
    await input.press("Enter");
    await until("the node has taken it", async () => /OUT1_TRIM = 1444/.test(await text(page, "#client")));
    await page.click("#save");
    await until("it is saved", async () => /executed|ok/i.test(await text(page, "#client")));
    await page.click("#restart");
    await until("it restarts", async () => (await text(page, "#monitor")).split("servo node").length > 2);
    await isRunning(page);
    await readParameters(page);
    assert.equal(await page.getByLabel("OUT1_TRIM").inputValue(), "1444");
    return page;
  },

  async "a fault shows and ends"(t) {
    const page = await open(t);
    await isRunning(page);
    const fault = page.locator("#fault-list button", { hasText: "error-storm" });
    await fault.click();
    await until("the fault is on", async () => (await fault.getAttribute("aria-pressed")) === "true");
    await until("error frames", async () => !/ 0 error frames/.test(await text(page, "#load")));
    await page.click("#end");
    await until("the fault is over", async () => (await fault.getAttribute("aria-pressed")) === "false");
    const errors = await text(page, "#load");
    const count = Number(/(\d+) error frames/.exec(errors)[1]);
    await until("time passes", async () => (await text(page, "#node-text")).includes("OK"));
    assert.ok(Number(/(\d+) error frames/.exec(await text(page, "#load"))[1]) <= count + 1);
    return page;
  },

  async "a frame shows its bits and the transaction that fetched it"(t) {
    const page = await open(t);
    await isRunning(page);
    await page.click("#previous");
    await page.locator("#traffic button", { hasText: "ArrayCommand" }).first().click();
    assert.match(await text(page, "#frame-title"), /autopilot: .*ArrayCommand.*bits/);
    const label = await page.locator("#scope").getAttribute("aria-label");
    assert.match(label, /bits of .* stuff bits/);
    const fields = await text(page, "#fields");
    for (const name of ["SOF", "DLC", "CRC", "ACK"]) {
      assert.ok(fields.includes(name), name);
    }
    await until("the transaction", async () => {
      await page.locator("#traffic button", { hasText: "ArrayCommand" }).first().click();
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
    await setSlider(page, ".output input", 0.5);
    await until("no sweep", async () => !(await isPressed(page, "#sweep")));
    await page.click("#sweep");
    await until("a sweep", () => isPressed(page, "#sweep"));
    await page.click("#silent");
    await until("the node misses commands", async () => (await text(page, "#health")) === "WARNING");
    assert.match(await text(page, "#conditions"), /command/);
    await page.click("#silent");
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
    await page.locator("#program").selectOption({ index: 1 });
    await isRunning(page);
    await page.click("#all-outputs");
    await until("it is disarmed", async () => !(await isPressed(page, "#armed")));
    await until("eight servos", async () => (await page.locator(".output").count()) === 8);
    await until("it is armed again", () => isPressed(page, "#armed"));
    for (const [servo, deflection] of [[2, 1], [7, -1]]) {
      await setSlider(page, ".output input", deflection, servo);
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
      const all = [...document.querySelectorAll("button, select, input, [tabindex='0']")];
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
    return page;
  },

  async "nothing is cut off at 390 pixels"(t) {
    const page = await open(t, { width: 390, height: 844 });
    await isRunning(page);
    const wide = await page.evaluate(() => {
      const { scrollWidth } = document.documentElement;
      const outside = [...document.querySelectorAll("section *")].filter((element) => {
        const inScroller = element.closest(".scroll, #traffic, #monitor, .uplot");
        return !inScroller && element.getBoundingClientRect().right > window.innerWidth + 1;
      });
      return { scrollWidth, outside: outside.map((element) => element.outerHTML.slice(0, 80)) };
    });
    assert.deepEqual(wide, { scrollWidth: 390, outside: [] });
    return page;
  },
};

const longTests = {
  async "another node floods the bus, and the node is well again afterwards"(t) {
    const page = await open(t);
    await isRunning(page);
    await page.locator("#fault-list button", { hasText: "babble" }).click();
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
    const input = page.getByLabel("OUT1_TRIM");
    await input.fill("1444");
    await input.press("Enter");
    await until("it is set", async () => /OUT1_TRIM = 1444/.test(await text(page, "#client")));
    await page.click("#save");
    await until("it is saved", async () => /executed|ok/i.test(await text(page, "#client")));
    await page.click("#erase");
    await page.waitForTimeout(1000);
    await page.click("#reset");
    await monitorHas(page, "the reset", /reset: reset pin/);
    await isRunning(page);
    await readParameters(page);
    assert.equal(await page.getByLabel("OUT1_TRIM").inputValue(), "1500");
    return page;
  },

  async "every fault can begin and end, and the node is well after each"(t) {
    const page = await open(t);
    await isRunning(page);
    const buttons = page.locator("#fault-list button");
    const count = await buttons.count();
    assert.ok(count >= 30, `${count} faults`);
    for (let index = 0; index < count; index++) {
      const button = buttons.nth(index);
      const name = await button.innerText();
      if (name.startsWith("other-dialect")) {
        continue;
      }
      await button.click();
      if ((await button.getAttribute("aria-pressed")) !== null) {
        await until(`${name} begins`, async () => (await button.getAttribute("aria-pressed")) === "true");
        await page.waitForTimeout(300);
        await page.click("#end");
        await until(`${name} ends`, async () => (await button.getAttribute("aria-pressed")) === "false");
      }
      // The node reports a brown-out for as long as it runs.
      const last = name.startsWith("brown-out") ? /after a brown-out/ : /^Node\s+OK/;
      await until(`well after ${name}`, async () => last.test(await text(page, "#node")));
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

async function takePictures() {
  mkdirSync(pictures, { recursive: true });
  const t = { errors: [] };
  const page = await tests["a parameter is set, saved, and survives a restart"](t);
  await page.click("#previous");
  await page.locator("#traffic button", { hasText: "ArrayCommand" }).first().click();
  await page.waitForTimeout(3000);
  await page.setViewportSize({ width: 1440, height: 1060 });
  await page.evaluate(() => window.scrollTo(0, 0));
  await atRealTime(page);
  await page.screenshot({ path: join(pictures, "web.png") });
  await page.setViewportSize({ width: 390, height: 844 });
  await page.waitForTimeout(1000);
  await page.evaluate(() => window.scrollTo(0, 0));
  await page.screenshot({ path: join(pictures, "web-narrow.png") });
  await page.close();
  assert.deepEqual(t.errors, []);
}

const chosen = Object.entries({ ...tests, ...(isLong || only ? longTests : {}) }).filter(
  ([name]) => !only || name.includes(only),
);
assert.ok(chosen.length > 0, `no test has "${only}" in its name`);
let failures = 0;
try {
  if (pictures) {
    await takePictures();
  } else {
    for (const [name, run] of chosen) {
      const t = { errors: [] };
      const start = Date.now();
      try {
        const page = await run(t);
        assert.deepEqual(t.errors, [], "errors in the console");
        const speed = await text(page, "#speed");
        await page.close();
        console.log(`ok    ${name}  (${((Date.now() - start) / 1000).toFixed(1)} s; ${speed})`);
      } catch (error) {
        failures++;
        console.log(`FAIL  ${name}\n${error.stack}\n${t.errors.join("\n")}`);
        await Promise.all(context.pages().map((page) => page.close()));
        await context.newPage();
      }
    }
  }
} finally {
  await close();
  server.close();
}
process.exitCode = failures ? 1 : 0;
