// The view "Real bus": an SLCAN adapter on a port, and what web/src/bus.rs makes of its bytes.

import { RealBus } from "pkg/web.js";
import boards from "boards.json";
import { BusPanel } from "./bus-panel";
import { CheckCard } from "./check";
import { byId, download, make, setText, timeLeft } from "./dom";
import { Parameters } from "./parameters";
import { Port, choosePort, findAgain, whenPluggedIn, whyNoPorts } from "./ports";
import { SimulatedPort } from "./simulated-port";
import { Tabs } from "./tabs";
import type { Lane } from "./timeline";
import type { BusNode, BusSnapshot, BusUpdate, FrameEvent } from "./types";

const OWNER = "Real bus";
const PREFIX = "can-";
/** Rates of SLCAN, the most usual first. */
const BIT_RATES = [1000, 500, 250, 125, 800, 100, 50, 20, 10];
/** Only adapters with a UART have a baud rate that matters. */
const BAUDS = [115_200, 230_400, 460_800, 921_600, 1_000_000, 2_000_000, 3_000_000, 57_600];
/** Longest wait of one read, so that what is due is sent in time. */
const READ_MS = 20;
/** Real time between two pictures. */
const DRAW_MS = 60;
/** A node that was silent for so long is shown as gone. */
const GONE_S = 3;
const IDLE = "Plug the adapter in, and press Connect.";
/** After so long each node must have been heard. */
const SILENT_S = 5;
const SILENT = "Nothing was heard. Is the bit rate right, and has the bus 120 ohms at both ends?";
/** CANables ignore the command, and give no answer to any. */
const MAY_NOT_LISTEN = ' Some adapters cannot listen only: "Ask for names" opens this one to send, too.';
const GARBAGE =
  "This is not an SLCAN adapter, or its port has another baud rate: disconnect, and choose another port, or another rate beside \"Its port\".";
/** So many lines that are not SLCAN, and no frame, are no adapter. */
const GARBAGE_LINES = 3;
/** What SLCAN leaves out. */
const NOTE =
  "SLCAN tells identifier, length and data; the other bits and the duration follow from them. It does not tell ACK, " +
  "error frames, repetitions, nor when a frame was on the bus: the time is that of arrival here, for one frame after the other.";
/** Lanes of the time line besides those of this page and of all others. */
const NODE_LANES = 4;

/** Programs that can be updated again. */
const UPDATABLE = ["full", "remote"];

interface NodeRow {
  row: HTMLTableRowElement;
  choose: HTMLButtonElement;
  cells: HTMLElement[];
}

interface UpdateRow {
  begun: number;
  element: HTMLElement;
  text: HTMLElement;
  bar: HTMLProgressElement;
  stop: HTMLButtonElement;
}

function duration(seconds: number) {
  const parts = [Math.floor(seconds / 3600), Math.floor(seconds / 60) % 60, seconds % 60];
  return parts.map((part) => String(part).padStart(2, "0")).join(":");
}

export class RealBusView {
  private readonly view = byId("view-bus");
  private readonly bus = new RealBus();
  private readonly frames = new BusPanel(PREFIX, [], null, (number) => this.bus.frame(number), undefined, NOTE);
  private readonly parameters = new Parameters(PREFIX, () => this.bus, () => `node-${this.chosen?.id}`);
  private readonly check = new CheckCard(
    this.bus,
    () => this.now(),
    () => this.chosen?.id ?? null,
  );
  private readonly nodes = new Map<number, NodeRow>();
  private readonly updates = new Map<number, UpdateRow>();
  private readonly bitRate = byId<HTMLSelectElement>("can-rate");
  private readonly baud = byId<HTMLSelectElement>("can-baud");
  private port: Port | SimulatedPort | null = null;
  /** True while an adapter is being opened, or is in use. */
  private isConnected = false;
  private running: Promise<void> = Promise.resolve();
  private begun = 0;
  private drawnAt = 0;
  private chosen: BusNode | null = null;
  /** What the adapter is told at the end. */
  private farewell: Uint8Array | null = null;

  constructor(private readonly simulated: SimulatedPort) {
    this.bitRate.append(...BIT_RATES.map((rate) => new Option(`${rate} kbit/s`, String(rate * 1000))));
    this.baud.append(...BAUDS.map((rate) => new Option(`${rate} baud`, String(rate))));
    new Tabs("can-parts");
    this.listen();
    const why = whyNoPorts();
    this.say(why ?? IDLE, why !== null);
    this.show(this.snapshot());
  }

  /** Draws what is new while the view is on the screen. */
  draw(time: number) {
    if (!this.view.hidden && time - this.drawnAt >= DRAW_MS) {
      this.drawnAt = time;
      this.show(this.snapshot());
    }
  }

  /** True while the bus is that of the simulation, which has to go on. */
  get isSimulated() {
    return this.isConnected && this.port === this.simulated;
  }

  private now() {
    return performance.now() - this.begun;
  }

  private snapshot(): BusSnapshot {
    return JSON.parse(this.bus.snapshot(this.now()));
  }

  private say(text: string, isError = false) {
    const status = byId("can-status");
    setText(status, text);
    status.classList.toggle("wrong", isError);
  }

  private sayOfUpdate(text: string) {
    setText(byId("can-update-status"), text);
  }

  // ---- the adapter ----

  /** The port of the last time, also if the adapter was unplugged meanwhile, or one that the user chooses. */
  private async choose(another: boolean) {
    const before = another ? null : this.port;
    const port = before instanceof Port && before.isGone ? await findAgain(before) : before;
    const chosen = port ?? (await choosePort());
    if (chosen === null) {
      this.say("No port was chosen. An adapter that is not in the list needs the driver of its USB chip.", true);
    }
    return chosen;
  }

  /** An adapter that was unplugged is there again. */
  private async notice() {
    const { port } = this;
    if (port instanceof Port && port.isGone && !this.isConnected) {
      const found = await findAgain(port);
      if (found !== null && port === this.port) {
        this.port = found;
        // With it ends the trouble that it had.
        this.bus.disconnect();
        this.say("The adapter is plugged in again: press Connect.");
      }
    }
  }

  private async connect(another = false) {
    const port = await this.choose(another);
    if (port === null || (this.isConnected && port === this.port)) {
      return;
    }
    if (this.isConnected) {
      this.farewell = this.bus.disconnect();
      await this.running;
    }
    await port.open(Number(this.baud.value), OWNER);
    this.port = port;
    this.begun = performance.now();
    this.bus.connect(Number(this.bitRate.value));
    this.forget();
    this.isConnected = true;
    this.farewell = null;
    this.running = this.run(port);
  }

  /** Carries bytes between the port and the bus until one of them ends. */
  private async run(port: Port | SimulatedPort) {
    try {
      while (this.bus.is_connected()) {
        this.bus.receive(await port.read(READ_MS), this.now());
        await this.write(port);
      }
      if (this.farewell) {
        await port.write(this.farewell);
      }
    } catch (error) {
      this.bus.close(error instanceof Error ? error.message : String(error));
    }
    if (port === this.simulated) {
      this.port = null;
    }
    await port.close();
    this.isConnected = false;
    this.say(IDLE);
    this.show(this.snapshot());
  }

  private async write(port: Port | SimulatedPort) {
    for (let bytes = this.bus.take_output(); bytes.length > 0; bytes = this.bus.take_output()) {
      await port.write(bytes);
      this.bus.poll(this.now());
    }
  }

  private forget() {
    this.frames.clear();
    this.parameters.clear();
    this.nodes.clear();
    byId("can-nodes").replaceChildren();
    this.chosen = null;
  }

  // ---- what it shows ----

  private show(snapshot: BusSnapshot) {
    for (const event of JSON.parse(this.bus.take_events()) as FrameEvent[]) {
      this.frames.add(event);
    }
    const { state, load, bit_rate } = snapshot;
    this.frames.setLanes(this.lanes(snapshot));
    this.frames.draw(snapshot.now, state === "open" ? `${(load * 100).toFixed(1)} % of ${bit_rate / 1000} kbit/s` : "");
    this.showState(snapshot);
    this.showNodes(snapshot.nodes);
    this.showChosen(snapshot);
    this.showUpdates(snapshot.updates);
  }

  private lanes({ nodes }: BusSnapshot): Lane[] {
    const ids = nodes.slice(0, NODE_LANES).map(({ id }) => id);
    return [
      { name: "this page", colour: "tool" },
      ...ids.map((id) => ({ name: `node ${id}`, colour: "node" })),
      { name: "others", colour: "other" },
    ];
  }

  private showState(snapshot: BusSnapshot) {
    const { state, trouble, own_id, listens_first, bit_rate } = snapshot;
    const rate = bit_rate / 1000;
    const connect = byId<HTMLButtonElement>("can-connect");
    setText(connect, this.isConnected ? "Disconnect" : "Connect");
    connect.disabled = !this.isConnected && whyNoPorts() !== null;
    byId<HTMLButtonElement>("can-simulated").disabled = this.isConnected;
    this.bitRate.disabled = this.baud.disabled = this.isConnected;
    const counters: [number, string][] = [
      [snapshot.received, "frames received"],
      [snapshot.sent, "sent"],
      [snapshot.dropped, "not sent: the adapter takes too few"],
      [snapshot.echoed, "returned by the adapter and ignored"],
      [snapshot.invalid, "lines of the adapter that are not SLCAN: is the baud rate right?"],
      [this.port?.losses.dropped ?? 0, "bytes lost: this machine is too slow"],
    ];
    const counted = counters.filter(([count], index) => count > 0 || index < 2);
    setText(byId("can-counters"), counted.map(([count, what]) => `${count} ${what}`).join(", "));
    const names = byId<HTMLButtonElement>("can-names");
    names.disabled = state !== "open" || own_id !== null;
    byId("can-send").hidden = state !== "asks";
    for (const id of ["can-candump", "can-pcap"]) {
      byId<HTMLButtonElement>(id).disabled = snapshot.logged === 0;
    }
    if (trouble) {
      this.say(trouble, true);
    } else if (state === "asks") {
      this.say(
        `This adapter cannot only listen. Open to send, it acknowledges frames, and at a wrong bit rate it disturbs the bus: press "Open to send" if this bus has ${rate} kbit/s.`,
        true,
      );
    } else if (state === "open" && snapshot.received === 0 && snapshot.invalid >= GARBAGE_LINES) {
      this.say(GARBAGE, true);
    } else if (state === "opening") {
      this.say("Opening the adapter.");
    } else if (state === "open" && own_id !== null) {
      this.say(`This page is node ${own_id} on the bus.`);
    } else if (state === "open" && listens_first) {
      this.say("Listening, to take a node ID that no node has.");
    } else if (state === "open" && snapshot.received === 0 && snapshot.now > SILENT_S) {
      this.say(`${SILENT}${snapshot.only_listens ? MAY_NOT_LISTEN : ""}`);
    } else if (state === "open" && snapshot.only_listens) {
      this.say("The page listens, and sends nothing until you ask for something.");
    } else if (state === "open") {
      this.say("The adapter acknowledges frames. The page sends none until you ask for something.");
    }
  }

  private showNodes(nodes: BusNode[]) {
    for (const node of nodes) {
      const { cells, row } = this.nodes.get(node.id) ?? this.addNode(node.id);
      const isGone = node.silent_s > GONE_S;
      const version = node.software === null ? "" : `${node.software} on ${node.hardware}`;
      const name = node.name === null ? "" : node.name || "bootloader, or no name";
      const heard = isGone ? `${node.silent_s.toFixed(0)} s ago` : "now";
      const texts = [name, node.health, node.mode, duration(node.uptime_s), version, heard];
      texts.forEach((text, index) => setText(cells[index], text));
      cells[1].className = isGone ? "badge" : `badge ${node.health}`;
      const hex = node.vendor_code.toString(16).padStart(4, "0");
      const code = node.vendor_code === 0 ? "" : `vendor-specific status 0x${hex}`;
      row.title = [...node.conditions, code, node.unique_id ? `unique ID ${node.unique_id}` : ""].join("\n").trim();
    }
    byId("can-no-nodes").hidden = nodes.length > 0;
  }

  private addNode(id: number): NodeRow {
    const choose = make("button", { type: "button", textContent: String(id) });
    choose.setAttribute("aria-label", `Node ${id}`);
    choose.addEventListener("click", () => {
      this.bus.choose(id);
      this.parameters.clear();
    });
    const health = make("span", { className: "badge" });
    const cells = [make("td"), health, make("td"), make("td"), make("td"), make("td")];
    const [name, , ...rest] = cells;
    const row = make("tr", {}, make("th", { scope: "row" }, choose), name, make("td", {}, health), ...rest);
    const after = [...this.nodes.keys()].filter((known) => known > id).sort((a, b) => a - b)[0];
    byId("can-nodes").insertBefore(row, this.nodes.get(after)?.row ?? null);
    const entry = { row, choose, cells };
    this.nodes.set(id, entry);
    return entry;
  }

  private showChosen({ state, chosen, nodes, client, updates, check }: BusSnapshot) {
    this.chosen = nodes.find(({ id }) => id === chosen) ?? null;
    for (const [id, { choose }] of this.nodes) {
      choose.setAttribute("aria-pressed", String(id === chosen));
    }
    const { chosen: node } = this;
    setText(byId("can-parameters-title"), node ? `Parameters of node ${node.id}` : "Parameters");
    const about = node?.conditions.length ? `: ${node.conditions.join(", ")}` : "";
    setText(byId("can-chosen"), node ? `Node ${node.id} ${node.name ?? ""}${about}` : "Choose a node in the table.");
    const isIdle = state === "open" && node !== null && node.dialect === "v0";
    this.check.show(check, isIdle);
    const isUsable = isIdle && !check?.runs;
    const isUpdated = updates.some((update) => update.node === chosen && update.runs);
    byId<HTMLInputElement>("can-file").disabled = !isUsable || isUpdated;
    byId<HTMLButtonElement>("can-own").disabled = !isUsable || isUpdated;
    if (client) {
      this.parameters.show(client, node?.is_ours ?? false);
    }
    this.parameters.enable(isUsable, client?.busy ?? false);
  }

  private showUpdates(updates: BusUpdate[]) {
    for (const { node, runs, text, is_updated, sent = 0, total = 0 } of updates) {
      const row = this.updates.get(node) ?? this.addUpdate(node);
      const outcome = runs ? "" : is_updated ? "updated: " : "NOT updated: ";
      if (sent === 0) {
        row.begun = performance.now();
      }
      const progress = runs && total > 0 ? `, ${sent} of ${total} bytes${timeLeft(row.begun, sent, total)}` : "";
      setText(row.text, `Node ${node}: ${outcome}${text}${progress}`);
      row.element.classList.toggle("wrong", !runs && !is_updated);
      row.element.classList.toggle("done", is_updated ?? false);
      row.bar.hidden = row.stop.hidden = !runs;
      row.bar.value = total > 0 ? sent / total : 0;
    }
  }

  private addUpdate(node: number): UpdateRow {
    const text = make("p", { role: "status" });
    const bar = make("progress", { max: 1 });
    bar.setAttribute("aria-label", `Progress of node ${node}`);
    const stop = make("button", { type: "button", textContent: "Stop" });
    stop.setAttribute("aria-label", `Stop the update of node ${node}`);
    stop.addEventListener("click", () => this.bus.stop_update(node, this.now()));
    const element = make("div", { className: "update" }, text, bar, stop);
    byId("can-updates").append(element);
    const row = { begun: performance.now(), element, text, bar, stop };
    this.updates.set(node, row);
    return row;
  }

  // ---- what the user asks for ----

  private update(node: BusNode, name: string, bytes: Uint8Array) {
    try {
      this.bus.update(node.id, bytes, this.now());
    } catch (error) {
      this.sayOfUpdate(`${name}: ${String(error)}`);
    }
  }

  /** A file that is dropped by accident must not update a node of an aircraft. */
  refuse(file: File | undefined) {
    if (file) {
      this.sayOfUpdate(`${file.name}: choose a node, and then the file with "Update with a .bin".`);
    }
  }

  /** Updates the chosen node with the page's own program for its hardware. */
  private async updateToOwn() {
    const { chosen: node } = this;
    if (node?.hardware === null) {
      this.bus.ask_names();
      this.sayOfUpdate("The page asks the node what it is. Press again when its version is in the table.");
    } else if (node && !node.takes_updates) {
      this.sayOfUpdate(
        `Node ${node.id} takes no update over the bus: its bootloader is the Arduino's own, or its program is one without updates. Flash it in "Your board".`,
      );
    } else if (node) {
      const known = Object.entries(boards.files).filter(([key]) => UPDATABLE.includes(key.split(" ")[2]));
      for (const name of new Set(known.map(([, name]) => name))) {
        const answer = await fetch(`files/${name}`);
        const bytes = new Uint8Array(await answer.arrayBuffer());
        if (answer.ok && this.bus.suits(node.id, bytes)) {
          this.update(node, name, bytes);
          return;
        }
      }
      this.sayOfUpdate(`The page has no program for node ${node.id} with hardware ${node.hardware}.`);
    }
  }

  private listen() {
    const click = (id: string, act: () => void) => byId(id).addEventListener("click", act);
    const connect = (another: boolean) => {
      this.connect(another).catch((error) => this.say(error instanceof Error ? error.message : String(error), true));
    };
    whenPluggedIn(() => void this.notice());
    click("can-connect", () => {
      if (this.isConnected) {
        this.farewell = this.bus.disconnect();
      } else {
        connect(false);
      }
    });
    click("can-simulated", () => {
      this.port = this.simulated;
      this.bitRate.value = String(this.simulated.bitRate);
      void this.connect();
    });
    click("can-other", () => connect(true));
    click("can-send", () => this.bus.allow_sending(this.now()));
    click("can-names", () => this.bus.ask_names());
    click("can-candump", () => download("bus.log", this.bus.candump() as BlobPart));
    click("can-pcap", () => download("bus.pcap", this.bus.pcap() as BlobPart));
    click("can-own", () => {
      this.updateToOwn().catch(() => this.sayOfUpdate("The page's server does not give its programs."));
    });
    const input = byId<HTMLInputElement>("can-file");
    input.addEventListener("change", () => {
      const file = input.files?.[0];
      const { chosen: node } = this;
      if (file && node) {
        void file.arrayBuffer().then((buffer) => this.update(node, file.name, new Uint8Array(buffer)));
      }
      input.value = "";
    });
  }
}
