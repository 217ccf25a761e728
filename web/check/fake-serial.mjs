// The browser's port API (Web Serial) with simulated boards behind it: `sim --serial`, or the adapter
// of `sim --slcan`, on a pseudo-terminal beside Chromium. Only this API is fake; page, board and
// bootloader are real.
//
// A pseudo-terminal has no DTR, and sim resets its board when the port is opened: a pulse of DTR
// closes and opens it here. A device that was unplugged gets another port, as in browsers.

import { execFileSync, spawn } from "node:child_process";
import { closeSync, constants, existsSync, mkdtempSync, openSync, readSync, rmSync, writeSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";

const POLL_MS = 2;
const START_MS = 60_000;
const { O_RDWR, O_NOCTTY, O_NONBLOCK } = constants;
const pause = (ms) => new Promise((done) => setTimeout(done, ms));

/** A simulated board on a port. `options` are those of sim, and `link` those before the path of the port. */
export class Board {
  constructor(sim, options, link = ["--no-autopilot", "--serial"]) {
    this.directory = mkdtempSync(join(tmpdir(), "board-"));
    this.path = join(this.directory, "port");
    this.output = "";
    this.isTaken = false;
    /** Bytes that still pass until the cable is pulled. */
    this.passing = Infinity;
    this.written = 0;
    this.fd = null;
    this.process = spawn(sim, ["--plain", ...link, this.path, ...options], { stdio: ["ignore", "pipe", "pipe"] });
    for (const stream of [this.process.stdout, this.process.stderr]) {
      stream.on("data", (part) => (this.output = (this.output + part).slice(-20_000)));
    }
  }

  /** Waits until the port is there. */
  async started() {
    for (const end = Date.now() + START_MS; !existsSync(this.path); ) {
      if (Date.now() > end || this.process.exitCode !== null) {
        throw new Error(`sim has no port: ${this.output}`);
      }
      await pause(20);
    }
    return this;
  }

  open(baud) {
    if (this.isTaken || this.fd !== null || !existsSync(this.path)) {
      return false;
    }
    this.baud = baud;
    this.fd = openSync(this.path, O_RDWR | O_NOCTTY | O_NONBLOCK);
    execFileSync("stty", ["-F", this.path, String(baud)]);
    return true;
  }

  close() {
    if (this.fd !== null) {
      closeSync(this.fd);
      this.fd = null;
    }
  }

  async reset() {
    const { baud } = this;
    this.close();
    await pause(30);
    this.open(baud);
  }

  /** Writes all bytes. False if the cable is pulled meanwhile. */
  async write(bytes) {
    let rest = bytes.subarray(0, Math.min(bytes.length, this.passing - this.written));
    const isCut = rest.length < bytes.length;
    this.written += rest.length;
    while (rest.length > 0 && this.fd !== null) {
      try {
        rest = rest.subarray(writeSync(this.fd, rest));
      } catch (error) {
        if (error.code !== "EAGAIN") {
          return false;
        }
        await pause(POLL_MS);
      }
    }
    return !isCut;
  }

  /** What has arrived; null if the port is gone. */
  read() {
    const buffer = Buffer.alloc(4096);
    if (this.fd === null) {
      return buffer.subarray(0, 0);
    }
    try {
      // A terminal whose other end is gone is at its end; one without bytes has EAGAIN.
      const length = readSync(this.fd, buffer);
      return length > 0 ? buffer.subarray(0, length) : null;
    } catch (error) {
      return error.code === "EAGAIN" ? buffer.subarray(0, 0) : null;
    }
  }

  async end() {
    this.close();
    if (this.process.exitCode === null) {
      this.process.kill("SIGINT");
      const ended = new Promise((done) => this.process.once("exit", done));
      await Promise.race([ended, pause(3000)]);
      this.process.kill("SIGKILL");
    }
    rmSync(this.directory, { recursive: true, force: true });
  }
}

/** What runs in the page: `navigator.serial` with one device, which `lose` and `plug` unplug and plug in. */
export function fake() {
  const toText = (bytes) => btoa(String.fromCharCode(...bytes));
  const lost = () => new DOMException("The device has been lost.", "NetworkError");
  class Port extends EventTarget {
    readable = null;
    writable = null;
    getInfo() {
      return { usbVendorId: 0x2341, usbProductId: 0x0043 };
    }
    async open({ baudRate }) {
      if (this.readable) {
        throw new DOMException("The port is already open.", "InvalidStateError");
      }
      if (this !== window.fakePort || !(await window.portOpen(baudRate))) {
        throw new DOMException("Failed to open serial port.", "NetworkError");
      }
      this.make();
    }
    make() {
      this.readable = new ReadableStream({ start: (controller) => (this.controller = controller) });
      this.writable = new WritableStream({
        write: async (bytes) => {
          if (!(await window.portWrite(toText(bytes)))) {
            this.lose();
            throw lost();
          }
        },
      });
    }
    receive(text) {
      try {
        this.controller?.enqueue(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)));
      } catch {
        // It is closed.
      }
    }
    /** The cable is pulled. */
    lose() {
      const { controller } = this;
      [this.readable, this.writable, this.controller] = [null, null, null];
      try {
        controller?.error(lost());
      } catch {
        // It is closed.
      }
      if (this === window.fakePort) {
        window.fakePort = null;
        tell("disconnect", this);
      }
    }
    async close() {
      [this.readable, this.writable, this.controller] = [null, null, null];
      await window.portClose();
    }
    async setSignals({ dataTerminalReady }) {
      if (!this.readable) {
        throw new DOMException("The port is closed.", "InvalidStateError");
      }
      if (dataTerminalReady && this.dtr === false) {
        await window.portReset();
      }
      this.dtr = dataTerminalReady;
    }
  }
  /** True when the user has chosen the device. */
  let isAllowed = false;
  /** The event is the port's, and bubbles. */
  const tell = (name, port) => [port, isAllowed ? serial : null].forEach((target) => target?.dispatchEvent(new Event(name)));
  window.plug = () => {
    window.fakePort = new Port();
    tell("connect", window.fakePort);
  };
  const serial = Object.assign(new EventTarget(), {
    requestPort: async () => {
      window.requests = (window.requests ?? 0) + 1;
      if (window.choosesNone || !window.fakePort) {
        throw new DOMException("No port selected by the user.", "NotFoundError");
      }
      isAllowed = true;
      return window.fakePort;
    },
    getPorts: async () => (isAllowed && window.fakePort ? [window.fakePort] : []),
  });
  window.plug();
  Object.defineProperty(Navigator.prototype, "serial", { get: () => serial, configurable: true });
}

/** Gives a page, before it is loaded, the port of a board. Returns what ends the connection. */
export async function connect(page, board) {
  await page.addInitScript(fake);
  let ended = false;
  await page.exposeFunction("portOpen", (baud) => board.open(baud));
  await page.exposeFunction("portClose", () => board.close());
  await page.exposeFunction("portReset", () => board.reset());
  await page.exposeFunction("portWrite", (text) => board.write(Buffer.from(text, "base64")));
  const pump = (async () => {
    while (!ended) {
      const bytes = board.read();
      if (bytes === null) {
        board.close();
        await page.evaluate(() => window.fakePort?.lose()).catch(() => {});
      } else if (bytes.length > 0) {
        await page.evaluate((text) => window.fakePort?.receive(text), bytes.toString("base64")).catch(() => {});
      } else {
        await pause(POLL_MS);
      }
    }
  })();
  return async () => {
    ended = true;
    await pump;
  };
}
