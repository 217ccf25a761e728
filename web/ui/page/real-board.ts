// The view "Your board": flashes a real Arduino, and is its serial monitor.

import { read_program } from "pkg/web.js";
import boards from "boards.json";
import { byId, download, onClick, setLinkedText, setText, timeLeft } from "./dom";
import { Lines, Monitor } from "./monitor";
import { type Port, choosePort, findAgain, whenPluggedIn, whyNoPorts } from "./ports";
import { type State, Uploader } from "./upload";

const OWNER = "Your board";
const IDLE = "Plug the board in, choose it and its CAN board, and press Flash.";
/** Baud rate of the programs of this project. */
const MONITOR_BAUD = 115_200;
const BAUDS = [9600, 19_200, 38_400, 57_600, 115_200, 230_400, 250_000];
/** Longest wait of one read of the monitor. */
const READ_MS = 250;
/** Lines of the monitor in a report: those of the start. */
const REPORT_LINES = 60;
/** Where the choice of the last visit is kept. */
const KEPT = "choice of your board";

const PHASES: Record<State["phase"], string> = {
  connecting: "Looking for the bootloader",
  writing: "Writing",
  comparing: "Reading back and comparing",
  ended: "Ended",
};

export class RealBoard {
  private readonly board = byId<HTMLSelectElement>("real-board");
  private readonly shield = byId<HTMLSelectElement>("real-shield");
  private readonly preset = byId<HTMLSelectElement>("real-preset");
  private readonly baud = byId<HTMLSelectElement>("real-baud");
  private readonly monitor = new Monitor(byId("real-monitor"));
  private port: Port | null = null;
  private uploader: Uploader | null = null;
  /** True while the monitor is to have the port. */
  private listens = false;
  /** Phase of the upload, and its begin. */
  private phase = { name: "", begun: 0 };
  /** The last upload in words, for the report. */
  private lastUpload = "none";
  /** A file of the user. */
  private own: { name: string; bytes: Uint8Array } | null = null;

  constructor() {
    const option = ({ name, title }: { name: string; title: string }) => new Option(title, name);
    this.board.append(...boards.boards.map(option));
    this.shield.append(...boards.shields.map(option));
    this.baud.append(...BAUDS.map((rate) => new Option(`${rate} baud`, String(rate))));
    this.baud.value = String(MONITOR_BAUD);
    this.restore();
    this.listen();
    const why = whyNoPorts();
    this.say(why ?? IDLE, why !== null);
    this.enable();
  }

  /** The page draws what is new. */
  draw(time: number) {
    this.monitor.draw(time);
  }

  /** Chooses a file of the user. */
  async open(file: File | undefined) {
    if (file && !this.isBusy) {
      this.own = { name: file.name, bytes: new Uint8Array(await file.arrayBuffer()) };
      this.show("");
    }
  }

  private get isBusy() {
    return this.uploader !== null;
  }

  private chosen() {
    const of = boards.boards.find(({ name }) => name === this.board.value) ?? boards.boards[0];
    const shield = boards.shields.find(({ name }) => name === this.shield.value) ?? boards.shields[0];
    return { of, shield, chip: boards.chips[of.chip] };
  }

  private restore() {
    try {
      const [board, shield, preset] = JSON.parse(localStorage.getItem(KEPT) ?? "[]");
      this.board.value = board ?? "uno";
      this.shield.value = shield ?? boards.shields[0].name;
      this.show(preset);
    } catch {
      // The browser keeps nothing, or something else.
      this.show();
    }
  }

  /** Shows what belongs to the choice. */
  private show(preset?: string) {
    if (this.board.selectedIndex < 0) {
      this.board.selectedIndex = 0;
    }
    if (this.shield.selectedIndex < 0) {
      this.shield.selectedIndex = 0;
    }
    const { of, shield, chip } = this.chosen();
    const presets = boards.presets[of.chip];
    const wanted = preset ?? this.preset.value;
    this.preset.replaceChildren(...presets.map(([name, text]) => new Option(`${name}: ${text}`, name)));
    this.preset.value = presets.some(([name]) => name === wanted) ? wanted : chip.preset;
    if (this.own) {
      const option = new Option(`own file: ${this.own.name}`, "");
      this.preset.append(option);
      this.preset.value = preset === undefined || preset === "" ? "" : this.preset.value;
    }
    const hasHub = of.chip === "atmega328p";
    setText(byId("real-drawing"), hasHub ? `${shield.drawing}\n\n${shield.hub}` : shield.drawing);
    this.showPicture(shield, of.chip);
    setText(byId("real-facts"), `${of.title} with an ${chip.title}; the bus has ${shield.bit_rate / 1000} kbit/s by default.`);
    const loader = byId<HTMLAnchorElement>("real-loader");
    loader.href = `files/${boards.loaders[`${of.name} ${shield.name}`]}`;
    try {
      localStorage.setItem(KEPT, JSON.stringify([of.name, shield.name, this.preset.value]));
    } catch {
      // The page works without.
    }
  }

  /** The drawing of the wiring, which is fetched when the view is on the screen. */
  private showPicture({ name, title }: { name: string; title: string }, chip: string) {
    const picture = byId<HTMLImageElement>("real-picture");
    picture.alt = `Wiring of ${title} and ${boards.chips[chip].title}, which is below as text`;
    picture.loading = "lazy";
    picture.src = `files/wiring-${name}-${chip}.svg`;
    byId<HTMLAnchorElement>("real-picture-file").href = picture.src;
  }

  private say(text: string, isError = false, isDone = false) {
    const status = byId("real-status");
    setLinkedText(status, text);
    status.classList.toggle("wrong", isError);
    status.classList.toggle("done", isDone);
    byId("real-next").hidden = !isDone;
  }

  private enable() {
    const cannot = whyNoPorts() !== null;
    byId<HTMLButtonElement>("real-flash").disabled = cannot || this.isBusy;
    byId<HTMLButtonElement>("real-connect").disabled = cannot || this.isBusy;
    byId<HTMLButtonElement>("real-other").disabled = cannot || this.isBusy;
    byId<HTMLButtonElement>("real-cancel").disabled = !this.isBusy;
    byId<HTMLButtonElement>("real-reset").disabled = !this.listens;
    for (const select of [this.board, this.shield, this.preset]) {
      select.disabled = this.isBusy;
    }
    setText(byId("real-connect"), this.listens ? "Disconnect" : "Connect");
    const gone = this.port?.isGone ? ", unplugged" : "";
    setText(byId("real-port"), this.port ? `${this.port.name}${gone}` : "no port chosen");
  }

  /**
   * The port of the last time, also if the board was unplugged meanwhile, or one that the user
   * chooses. Has to be called in a click.
   */
  private async choose(another = false) {
    if (!another && this.port?.isGone) {
      this.use((await findAgain(this.port)) ?? this.port);
    }
    if (another || this.port === null || this.port.isGone) {
      const chosen = await choosePort();
      if (chosen === null) {
        this.say("No port was chosen. A board that is not in the list has a cable without data wires, or needs the driver of its USB chip (CH340, FTDI).");
        return null;
      }
      if (this.port !== chosen) {
        const listened = this.listens;
        await this.disconnect();
        this.use(chosen);
        if (listened) {
          await this.connect();
        }
      }
    }
    return this.port;
  }

  private use(port: Port) {
    this.port = port;
    port.whenGone = () => {
      if (port === this.port && !port.isOpen) {
        this.say("The board was unplugged. Plug it in again, and press Flash.");
        this.enable();
      }
    };
  }

  /** The bytes to write, from beside the page or from the user's file. */
  private async program() {
    const { of, shield } = this.chosen();
    const preset = this.preset.value;
    let bytes = this.own?.bytes;
    let name = this.own?.name ?? "";
    if (preset !== "") {
      name = boards.files[`${of.name} ${shield.name} ${preset}`];
      const answer = await fetch(`files/${name}`).catch(() => null);
      if (!answer?.ok) {
        throw new Error(`The page's server does not give files/${name}. From a file on the disk the page has no programs: use https, or make web.`);
      }
      bytes = new Uint8Array(await answer.arrayBuffer());
    }
    try {
      return read_program(bytes ?? new Uint8Array(), of.name, shield.name);
    } catch (error) {
      throw new Error(`${name}: ${String(error)}. Nothing was written.`);
    }
  }

  private async flash() {
    if (this.isBusy) {
      return;
    }
    try {
      const port = await this.choose();
      if (port === null) {
        return;
      }
      const { of } = this.chosen();
      this.uploader = new Uploader(port, (state) => this.showProgress(state));
      this.enable();
      const program = await this.program();
      await this.disconnect();
      const begun = performance.now();
      const state = await this.uploader.upload(program, of.chip, of.baud, OWNER);
      const seconds = ((performance.now() - begun) / 1000).toFixed(1);
      this.lastUpload = `${program.length} bytes, ${seconds} s: ${state.failure ?? "complete"}`;
      if (state.failure !== null) {
        this.say(state.is_silent ? state.failure : `${state.failure} ${state.flash}`, true);
      } else {
        this.say(`${state.flash} ${program.length} bytes in ${seconds} s.`, false, true);
        this.uploader = null;
        await this.connect();
      }
    } catch (error) {
      this.fail(error);
    } finally {
      this.uploader = null;
      byId("real-progress").hidden = true;
      this.enable();
    }
  }

  /** What a stranger needs to know of this board, as Markdown. */
  private report() {
    const { of, shield, chip } = this.chosen();
    const rows = [
      `* Board: ${of.title} (${chip.title}), ${shield.title}`,
      `* Program: ${this.preset.value || this.own?.name}`,
      `* Last upload: ${this.lastUpload}`,
      `* Port: ${this.port?.name ?? "none"}`,
      `* Browser: ${navigator.userAgent}`,
    ];
    const lines = this.monitor.text().split("\n").slice(0, REPORT_LINES);
    return `${rows.join("\n")}\n\n${lines.map((line) => `    ${line}`).join("\n")}\n`;
  }

  /** What is wrong with the port, or with the file. */
  private fail(error: unknown) {
    const text = error instanceof Error ? error.message : String(error);
    const state = this.uploader?.state;
    this.say(state ? `${text} ${state.flash}` : text, true);
    this.lastUpload = state ? text : this.lastUpload;
  }

  private showProgress({ phase, done, all, chip }: State) {
    const bar = byId<HTMLProgressElement>("real-progress");
    bar.hidden = false;
    if (phase === "connecting") {
      bar.removeAttribute("value");
    } else {
      bar.value = done / Math.max(all, 1);
    }
    if (phase !== this.phase.name) {
      this.phase = { name: phase, begun: performance.now() };
    }
    const percent = phase === "connecting" ? "" : `, ${Math.floor((100 * done) / Math.max(all, 1))} %${timeLeft(this.phase.begun, done, all)}`;
    const of = chip === null ? "" : ` (${boards.chips[chip].title})`;
    if (phase !== "ended") {
      this.say(`${PHASES[phase]}${of}${percent}`);
    }
  }

  /** Opens the port for the monitor. The board starts anew, as with any serial monitor. */
  private async connect() {
    const { port } = this;
    if (port === null) {
      return;
    }
    await port.open(Number(this.baud.value), OWNER);
    this.listens = true;
    this.enable();
    void this.hear(port);
    await port.reset();
  }

  private async hear(port: Port) {
    const lines = new Lines();
    try {
      while (this.listens && port === this.port) {
        lines.take(await port.read(READ_MS)).forEach((line) => this.monitor.add(line));
      }
    } catch (error) {
      this.monitor.add("[the port is gone]");
      this.fail(error);
      this.listens = false;
      await port.close();
      this.enable();
    }
  }

  private async disconnect() {
    if (this.listens) {
      this.listens = false;
      await this.port?.close();
      this.enable();
    }
  }

  private async send(text: string) {
    if (this.listens && this.port) {
      await this.port.write(new TextEncoder().encode(text));
    } else {
      this.say("Connect the serial monitor first.", true);
    }
  }

  private listen() {
    const attempt = (act: () => Promise<unknown>) => {
      act().catch((error) => this.fail(error)).finally(() => this.enable());
    };
    const click = (id: string, act: () => Promise<unknown>) =>
      byId(id).addEventListener("click", () => attempt(act));
    for (const select of [this.board, this.shield, this.preset]) {
      select.addEventListener("change", () => this.show(this.preset.value));
    }
    whenPluggedIn(() => {
      const { port } = this;
      if (port?.isGone && !this.isBusy) {
        attempt(async () => {
          const found = await findAgain(port);
          if (found !== null && port === this.port) {
            this.use(found);
            this.say("The board is plugged in again: press Flash.");
          }
        });
      }
    });
    click("real-flash", () => this.flash());
    click("real-other", () => this.choose(true));
    click("real-reset", async () => this.port?.reset());
    click("real-connect", async () => {
      if (this.listens) {
        await this.disconnect();
      } else if (await this.choose()) {
        await this.connect();
      }
    });
    onClick("real-to-bus", () => byId("tab-bus").click());
    window.addEventListener("beforeunload", (event) => {
      if (this.isBusy) {
        event.preventDefault();
      }
    });
    byId("real-cancel").addEventListener("click", () => this.uploader?.cancel());
    this.baud.addEventListener("change", () =>
      attempt(async () => {
        if (this.listens) {
          await this.disconnect();
          await this.connect();
        }
      }),
    );
    byId("real-send").addEventListener("submit", (event) => {
      event.preventDefault();
      const text = byId<HTMLInputElement>("real-text");
      attempt(() => this.send(text.value || "?"));
      text.value = "";
    });
    click("real-report", async () => {
      await navigator.clipboard.writeText(this.report());
      this.say("The report is copied: paste it into an issue.");
    });
    click("real-copy", async () => {
      await navigator.clipboard.writeText(this.monitor.text());
      this.say("The lines of the monitor are copied.");
    });
    byId("real-download").addEventListener("click", () => download("monitor.txt", this.monitor.text()));
    byId("real-clear").addEventListener("click", () => this.monitor.clear());
    const input = byId<HTMLInputElement>("real-file");
    input.addEventListener("change", () => {
      void this.open(input.files?.[0]);
      input.value = "";
    });
  }
}
