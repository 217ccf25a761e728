// Serial ports of this computer, by the Web Serial API (https://wicg.github.io/serial/). Only this
// module calls the API. Its errors say in words what is wrong and what to do.

/** A port of the API, as far as it is used here. */
interface NativePort extends EventTarget {
  readonly readable: ReadableStream<Uint8Array> | null;
  readonly writable: WritableStream<Uint8Array> | null;
  open(options: { baudRate: number; bufferSize: number }): Promise<void>;
  close(): Promise<void>;
  setSignals(signals: { dataTerminalReady: boolean; requestToSend: boolean }): Promise<void>;
  getInfo(): { usbVendorId?: number; usbProductId?: number };
}

interface Serial extends EventTarget {
  requestPort(): Promise<NativePort>;
  /** The ports that the user has allowed before, and that are plugged in. */
  getPorts(): Promise<NativePort[]>;
}

export type Trouble = "unsupported" | "denied" | "taken" | "unplugged" | "stuck" | "unusable";

/** What is wrong with a port; the message is for the user. */
export class PortError extends Error {
  constructor(
    readonly trouble: Trouble,
    message: string,
  ) {
    super(message);
  }
}

/** Bytes that wait in the browser. */
const BUFFER_BYTES = 65_536;
/** Bytes that wait for `read`. Older ones are dropped, and counted. */
const QUEUE_BYTES = 1 << 20;
/** A port that takes no bytes for this long hangs. */
const WRITE_MS = 5000;
/** An Arduino's reset line needs this long to rise again, as avrdude has it. */
const RISE_MS = 250;

/** Names of adapters by USB vendor. */
const VENDORS: Record<number, string> = {
  0x2341: "Arduino",
  0x2a03: "Arduino",
  0x1a86: "CH340",
  0x0403: "FTDI",
  0x10c4: "CP210x",
  0x067b: "PL2303",
  0x1d50: "OpenMoko",
  0x0483: "STM32",
  0x16d0: "MCS",
};

const UNPLUGGED = "The port is gone: the cable was unplugged, or the board has lost its supply. Plug it in again.";
const TAKEN =
  "The port does not open. Most often another program has it: close the serial monitor of the Arduino IDE, " +
  "a slicer, another tab with this page. On Linux you need the rights, too: sudo usermod -a -G dialout $USER, " +
  "then log in again.";
const STUCK = "The port takes no bytes: unplug the adapter or the board, and plug it in again.";

const pause = (ms: number) => new Promise<void>((done) => setTimeout(done, ms));
const nameOf = (error: unknown) => (error instanceof Error ? error.name : "");
const textOf = (error: unknown) => (error instanceof Error ? error.message : String(error));

/** Why this page has no ports in this browser; null if it has. */
export function whyNoPorts(): string | null {
  if ("serial" in navigator) {
    return null;
  }
  if (!window.isSecureContext) {
    return "Browsers give ports only to pages from https or from localhost. Open this page by https, or serve it on this machine: make web.";
  }
  return "This browser has no serial ports: it lacks the interface Web Serial (navigator.serial). Open the page in one that has it: caniuse.com/web-serial lists them.";
}

const known = new WeakMap<NativePort, Port>();
const serial = () => (navigator as unknown as { serial: Serial }).serial;

/** Calls back when a port that the user has allowed before is plugged in. */
export function whenPluggedIn(act: () => void) {
  if (whyNoPorts() === null) {
    serial().addEventListener("connect", act);
  }
}

/** The port of the same device after it was plugged in again; null if it is not there, or not certain. */
export async function findAgain(port: Port): Promise<Port | null> {
  const same = (await serial().getPorts()).filter((native) => port.isLike(native));
  if (same.length !== 1) {
    return null;
  }
  const before = known.get(same[0]);
  const found = before && !before.isGone ? before : new Port(same[0]);
  known.set(same[0], found);
  return found;
}

/** Asks the user for a port; null if the user chooses none. Has to be called in a click. */
export async function choosePort(): Promise<Port | null> {
  const why = whyNoPorts();
  if (why !== null) {
    throw new PortError("unsupported", why);
  }
  let native: NativePort;
  try {
    native = await serial().requestPort();
  } catch (error) {
    if (nameOf(error) === "NotFoundError") {
      return null;
    }
    throw new PortError("denied", `The browser allows this page no ports (${textOf(error)}). Allow "Serial ports" in its settings for this page.`);
  }
  const before = known.get(native);
  const port = before && !before.isGone ? before : new Port(native);
  known.set(native, port);
  return port;
}

/** A serial port. Bytes that arrive wait for `read`, which one caller at a time may use. */
export class Port {
  /** The part of the page that has opened the port; null if it is closed. */
  private owner: string | null = null;
  private queue: Uint8Array[] = [];
  private queued = 0;
  private dropped = 0;
  private broken = 0;
  private isClosing = false;
  private trouble: PortError | null = null;
  private receiving: Promise<void> = Promise.resolve();
  private reader: ReadableStreamDefaultReader<Uint8Array> | null = null;
  private wake: () => void = () => {};
  /** True from when the device was unplugged. It gets another port when it is plugged in again. */
  isGone = false;
  /** Called when the device is unplugged. */
  whenGone: () => void = () => {};

  constructor(private readonly native: NativePort) {
    native.addEventListener("disconnect", () => {
      this.isGone = true;
      this.whenGone();
    });
  }

  /** True for a port of the same kind of device. */
  isLike(other: NativePort) {
    const [mine, its] = [this.native.getInfo(), other.getInfo()];
    return mine.usbVendorId === its.usbVendorId && mine.usbProductId === its.usbProductId;
  }

  /** Maker of the USB chip, if it is known, and its numbers. */
  get name() {
    const { usbVendorId, usbProductId } = this.native.getInfo();
    if (usbVendorId === undefined) {
      return "serial port";
    }
    const digits = (id = 0) => id.toString(16).padStart(4, "0").toUpperCase();
    return `${VENDORS[usbVendorId] ?? "USB"} ${digits(usbVendorId)}:${digits(usbProductId)}`;
  }

  get isOpen() {
    return this.owner !== null;
  }

  /** Bytes that were dropped because nobody read them, and characters that arrived broken. */
  get losses() {
    return { dropped: this.dropped, broken: this.broken };
  }

  /** Opens the port for a part of the page, whose name is for the user. */
  async open(baudRate: number, owner: string) {
    if (this.owner !== null) {
      throw new PortError("taken", `"${this.owner}" of this page uses this port: disconnect it there first.`);
    }
    this.owner = owner;
    try {
      await this.native.open({ baudRate, bufferSize: BUFFER_BYTES });
    } catch (error) {
      this.owner = null;
      // A browser need not have told that the device was unplugged.
      if (this.isGone || !(await serial().getPorts()).includes(this.native)) {
        throw this.lost();
      }
      const isTaken = ["NetworkError", "InvalidStateError"].includes(nameOf(error));
      throw isTaken ? new PortError("taken", TAKEN) : new PortError("unusable", `The port does not open: ${textOf(error)}`);
    }
    this.discard();
    [this.dropped, this.broken] = [0, 0];
    [this.isClosing, this.trouble] = [false, null];
    this.receiving = this.receive();
  }

  /** Closes the port. Never throws; what waits is dropped. */
  async close() {
    if (this.owner === null || this.isClosing) {
      return;
    }
    this.isClosing = true;
    try {
      await this.reader?.cancel();
      await this.receiving;
      await this.native.close();
    } catch {
      // It is gone.
    }
    this.discard();
    this.owner = null;
    this.wake();
  }

  /** Bytes that have arrived; waits at most `waitMs` for the first, and is empty then. */
  async read(waitMs: number): Promise<Uint8Array> {
    if (this.queued === 0 && this.trouble === null && this.isOpen) {
      await new Promise<void>((done) => {
        const timer = setTimeout(done, waitMs);
        this.wake = () => {
          clearTimeout(timer);
          done();
        };
      });
    }
    if (this.queued > 0) {
      const all = new Uint8Array(this.queued);
      let at = 0;
      for (const bytes of this.queue.splice(0)) {
        all.set(bytes, at);
        at += bytes.length;
      }
      this.queued = 0;
      return all;
    }
    if (this.trouble) {
      throw this.trouble;
    }
    return new Uint8Array();
  }

  async write(bytes: Uint8Array) {
    if (this.trouble) {
      throw this.trouble;
    }
    const writer = this.native.writable?.getWriter();
    if (!writer) {
      throw this.lost();
    }
    let timer: ReturnType<typeof setTimeout> | undefined;
    const late = new Promise<never>((_, fail) => {
      timer = setTimeout(() => fail(new PortError("stuck", STUCK)), WRITE_MS);
    });
    try {
      await Promise.race([writer.write(bytes), late]);
    } catch (error) {
      if (error instanceof PortError) {
        void writer.abort().catch(() => {});
        throw error;
      }
      throw this.lost();
    } finally {
      clearTimeout(timer);
      writer.releaseLock();
    }
  }

  /**
   * Resets an Arduino by DTR and RTS, as avrdude does. False if the port has no such wires: then
   * the user has to press the button.
   */
  async reset() {
    try {
      await this.native.setSignals({ dataTerminalReady: false, requestToSend: false });
      await pause(RISE_MS);
      this.discard();
      await this.native.setSignals({ dataTerminalReady: true, requestToSend: true });
      return true;
    } catch {
      if (this.trouble) {
        throw this.trouble;
      }
      return false;
    }
  }

  private lost() {
    this.isGone = true;
    return new PortError("unplugged", UNPLUGGED);
  }

  /** Drops what has arrived. */
  private discard() {
    this.queue = [];
    this.queued = 0;
  }

  /** Fills the queue until the port is closed or gone. */
  private async receive() {
    while (this.native.readable && !this.isClosing) {
      this.reader = this.native.readable.getReader();
      try {
        for (;;) {
          const { value, done } = await this.reader.read();
          if (done) {
            break;
          }
          this.add(value);
        }
      } catch {
        // A character that arrived broken, as with a wrong baud rate, ends the stream, and the port
        // has another one. A port that is gone has none.
        this.broken++;
      } finally {
        this.reader.releaseLock();
        this.reader = null;
      }
    }
    if (!this.isClosing) {
      this.trouble = this.lost();
      this.wake();
    }
  }

  private add(bytes: Uint8Array) {
    this.queue.push(bytes);
    this.queued += bytes.length;
    while (this.queued > QUEUE_BYTES) {
      const oldest = this.queue.shift()!;
      this.queued -= oldest.length;
      this.dropped += oldest.length;
    }
    this.wake();
  }
}
