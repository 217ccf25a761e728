// The page: runs the simulation in slices between two pictures, and draws what it says.

import "./app.css";
import "uplot/dist/uPlot.min.css";
import wasm from "binary/web_bg.wasm";
import { Program, Simulation, choices, faults, four_motors, initSync } from "pkg/web.js";
import { OwnBoard } from "./board";
import { Detail } from "./detail";
import { byId, download, make, setPressed, setText } from "./dom";
import { encode, forget, keep, kept } from "./eeprom";
import { Faults } from "./faults";
import { type Link, fromHash, toHash } from "./link";
import { Marks } from "./marks";
import { Monitor } from "./monitor";
import { type Hold, Outputs } from "./outputs";
import { Parameters } from "./parameters";
import { Plots } from "./plots";
import { type Choice, PROGRAMS, SECOND, nameOfEeprom } from "./programs";
import { RealBoard } from "./real-board";
import { RealBusView } from "./real-bus";
import { SimulatedPort } from "./simulated-port";
import { type Lane, Timeline } from "./timeline";
import { Tour } from "./tour";
import type { PageEvent, Snapshot } from "./types";
import { Views } from "./views";

const CYCLES_PER_MS = 16_000;
/** Simulated time of one slice, between two looks at the clock. */
const SLICE_MS = 1;
/** Real time that the simulation may take between two pictures. */
const BUDGET_MS = 14;
/** Real time that the simulation may be behind before the page says that it cannot keep up. */
const LAG_MS = 250;
const SLOW = 0.97;
/** Simulated time of a recording of the wires. */
const RECORDING_S = 1;
/** The first letter of a script: a time in brackets, or a comment. A program begins otherwise. */
const SCRIPT = /^\s*[(#]/;
/** Real time between two pictures of what is drawn. */
const DRAW_MS = 30;
/** Simulated time in which the node hears that it is disarmed: ArmingStatus comes twice a second. */
const DISARM_S = 0.7;
/** Simulated time after which the node has saved and restarted, or did not accept the number. */
const RESTART_S = 10;
/** Real time between two looks at the EEPROM, which the browser keeps. */
const KEEP_MS = 1000;
/** Senders on the time line. */
const LANES: Lane[] = [
  { name: "autopilot", colour: "autopilot" },
  { name: "node", colour: "node" },
  { name: "tool", colour: "tool" },
  { name: "others", colour: "other" },
];
/** The longest simulated time in which "One frame" waits for a frame. */
const STEP_MS = 2000;

const NO_LOADER = new Uint8Array();

initSync({ module: wasm.slice() });

class Page {
  private simulation!: Simulation;
  private snapshot!: Snapshot;
  private running = true;
  /** Real time up to which the simulation should be, less the simulated time. */
  private offset = 0;
  /** Simulated time for a unit of real time. */
  private rate = 1;
  private behind = false;
  private speed = { at: 0, simulated: 0, factor: 1 };
  private drawnAt = 0;
  private restDrawnAt = 0;
  /** Simulated time at which the recording of the wires ends; null without one. */
  private recordedTo: number | null = null;
  /** True while a slider holds an output. */
  private isHeld = false;
  /** What "Use all outputs" does next, and when; null when it does nothing. */
  private expand: { step: "disarm" | "arm"; at: number; settings: [string, number][] } | null = null;
  private current: Choice = PROGRAMS[0];
  private keptAt = 0;
  /** True until the parameters of the started node are asked for. */
  private readsParameters = true;
  /** Parameters that were set, but not saved. */
  private readonly unsaved = new Map<string, number>();
  /** Faults of a link, which begin when the node runs. */
  private faultsToBegin: string[] = [];
  /** The file that the user opened last. */
  private own: Choice | null = null;
  /** A link whose program the user has to choose. */
  private waitingLink: Link | null = null;

  /** True while the simulated board is on the screen; otherwise its time stands still. */
  private isShown = true;

  private readonly monitor = new Monitor(byId("monitor"));
  private readonly realBoard = new RealBoard();
  private readonly realBus = new RealBusView(new SimulatedPort(() => this.simulation));
  private readonly views = new Views();
  private readonly marks = new Marks();
  private readonly plots = new Plots(this.marks);
  private readonly detail = new Detail("");
  private readonly timeline = new Timeline("", LANES, this.marks, (number) => this.showFrame(number));
  private readonly hold: Hold = (output, motor, command) => {
    this.isHeld = true;
    if (motor === null) {
      this.simulation.hold(output, command);
    } else {
      this.simulation.hold_motor(motor, command);
    }
  };
  private readonly outputs = new Outputs(byId("outputs"), this.hold);
  /** True if there is a second board. */
  private hasSecond = false;
  private readonly second = new Outputs(byId("second-outputs"), this.hold);
  private readonly parameters = new Parameters("", (name, text) => {
    this.simulation.write_parameter(name, text);
    // A link has numbers.
    if (Number.isFinite(Number(text))) {
      this.unsaved.set(name, Number(text));
    }
  });
  private readonly ownBoard = new OwnBoard(JSON.parse(choices()), () => {
    if (this.own) {
      this.own = { ...this.own, wiring: this.ownBoard.wiring() };
      this.load(this.own);
    }
  });
  private readonly fourMotors: [string, number][] = JSON.parse(four_motors());
  private readonly faults = new Faults(JSON.parse(faults()), (name) => this.simulation.inject(name));

  constructor() {
    new Tour();
    this.listen();
    this.listenToFiles();
    this.load(PROGRAMS[0]);
    this.openLink();
    window.addEventListener("hashchange", () => this.openLink());
    this.views.onChange((name) => {
      this.isShown = name === "simulated";
      this.synchronise();
    });
    this.views.follow();
    requestAnimationFrame((time) => this.picture(time));
  }

  /** Starts a program with the EEPROM that it left; a wrong file leaves the present one running. */
  private load(choice: Choice) {
    let next: Simulation;
    try {
      const program = Program.parse(choice.bytes, choice.wiring || "{}");
      if (!program.names_chip()) {
        this.askForChip(choice);
        return;
      }
      const eeprom = kept(nameOfEeprom(choice), program.eeprom());
      next = new Simulation(program, choice.loader ?? NO_LOADER, eeprom, choice.autopilot);
      if (this.hasSecond) {
        next.add_second(Program.parse(SECOND, "{}"));
      }
    } catch (error) {
      this.notice(`${choice.name} cannot run here: ${String(error)}`);
      this.showChoice();
      return;
    }
    this.notice("");
    this.simulation?.free();
    this.simulation = next;
    this.current = choice;
    this.ownBoard.show(choice.wiring ?? null);
    this.showChoice();
    this.isHeld = false;
    this.unsaved.clear();
    this.faultsToBegin = [];
    this.expand = null;
    byId<HTMLSelectElement>("pattern").value = choice.autopilot;
    byId<HTMLInputElement>("temperature").value = "20";
    byId<HTMLInputElement>("brightness").value = "0";
    this.recordedTo = null;
    this.monitor.clear();
    this.timeline.clear();
    this.plots.clear();
    this.marks.clear();
    this.parameters.clear();
    // The thesis's node has none.
    this.readsParameters = choice.autopilot !== "thesis";
    this.detail.hide();
    this.synchronise();
    this.snapshot = JSON.parse(next.snapshot());
    setText(byId("wiring"), this.snapshot.board);
    setText(byId("node-text"), "");
    byId("button").hidden = !this.snapshot.has_button;
    byId("light-box").hidden = !this.snapshot.has_light;
  }

  /** A HEX file does not say its chip. */
  private askForChip(choice: Choice) {
    this.notice(`${choice.name} does not say for which chip it is: choose chip or board.`, false);
    this.ownBoard.show(choice.wiring ?? "");
    this.ownBoard.ask();
  }

  private reboot() {
    keep(nameOfEeprom(this.current), encode(this.simulation.eeprom()));
    this.load(this.current);
  }

  /** Plays a script from power-on, from which its times count. */
  private play(name: string, script: Uint8Array) {
    this.reboot();
    try {
      this.notice(`${name} plays: ${this.simulation.play(script)}.`, false);
    } catch (error) {
      this.notice(`${name}: ${String(error)}`);
    }
  }

  /** The list names the program that runs, also one from a file. */
  private showChoice() {
    const select = byId<HTMLSelectElement>("program");
    const index = PROGRAMS.findIndex(({ name }) => name === this.current.name);
    while (select.options.length > PROGRAMS.length) {
      select.options[PROGRAMS.length].remove();
    }
    if (index < 0) {
      select.append(new Option(this.current.name));
    }
    select.selectedIndex = index < 0 ? PROGRAMS.length : index;
  }

  /** Real time goes on from the present simulated time. */
  private synchronise() {
    const simulated = this.simulation.now() / CYCLES_PER_MS;
    const at = performance.now();
    this.offset = at - simulated / this.rate;
    this.behind = false;
    this.speed = { at, simulated, factor: this.rate };
  }

  private notice(text: string, isError = true) {
    byId("notice").classList.toggle("error", isError);
    byId("notice").hidden = text === "";
    setText(byId("notice"), text);
  }

  /** Loads what the address has. */
  private openLink() {
    const link = fromHash(location.hash);
    const program = PROGRAMS.find(({ name }) => name === link?.program);
    if (link && program) {
      this.loadLink(link, program.bytes);
    } else if (link) {
      this.waitingLink = link;
      this.notice(`This link is for the program ${link.program}: choose the file, with "Own ELF or HEX".`, false);
    }
  }

  private loadLink(link: Link, bytes: Uint8Array) {
    // The user's own EEPROM of the program stays.
    const keptAs = "a link";
    keep(keptAs, link.eeprom);
    const { program: name, pattern: autopilot, wiring } = link;
    const isOwn = !PROGRAMS.some((program) => program.name === name);
    const choice = { name, bytes, autopilot, keptAs, wiring: isOwn ? wiring : undefined };
    this.own = isOwn ? choice : null;
    this.load(choice);
    link.parameters.forEach(([name, value]) => this.unsaved.set(name, value));
    this.faultsToBegin = link.faults;
  }

  /** The address of the page gets what runs. */
  private async copyLink() {
    const hash = toHash({
      program: this.current.name,
      pattern: byId<HTMLSelectElement>("pattern").value,
      wiring: this.current.wiring ?? "",
      eeprom: encode(this.simulation.eeprom()),
      parameters: [...this.unsaved],
      faults: this.snapshot.faults,
    });
    history.replaceState(null, "", hash);
    const isCopied = await navigator.clipboard?.writeText(location.href).then(
      () => true,
      () => false,
    );
    const how = isCopied ? "It is copied." : "Copy it from there.";
    this.notice(`The address of this page restores what runs now. ${how}`, false);
  }

  private picture(time: number) {
    this.realBoard.draw(time);
    this.realBus.draw(time);
    if (this.isShown || this.realBus.isSimulated) {
      this.pictureOfSimulation(time);
    }
    requestAnimationFrame((next) => this.picture(next));
  }

  private pictureOfSimulation(time: number) {
    if (this.running) {
      this.run(time);
    }
    if (time - this.drawnAt >= DRAW_MS) {
      this.drawnAt = time;
      this.snapshot = JSON.parse(this.simulation.snapshot());
      for (const event of JSON.parse(this.simulation.take_events()) as PageEvent[]) {
        this.take(event);
      }
      this.show(time);
    }
    if (time - this.keptAt >= KEEP_MS) {
      this.keptAt = time;
      keep(nameOfEeprom(this.current), encode(this.simulation.eeprom()));
    }
  }

  /** Simulates up to the present moment, as far as the budget allows. */
  private run(time: number) {
    const start = performance.now();
    const wanted = this.rate === Infinity ? Infinity : (time - this.offset) * this.rate;
    let simulated = this.simulation.now() / CYCLES_PER_MS;
    while (simulated < wanted && performance.now() - start < BUDGET_MS) {
      simulated += SLICE_MS;
      this.simulation.advance(simulated * CYCLES_PER_MS);
    }
    if (wanted - simulated > LAG_MS * this.rate) {
      // What was missed is not made up for.
      this.offset += (wanted - simulated) / this.rate;
    }
    if (time - this.speed.at > 1000) {
      const factor = (simulated - this.speed.simulated) / (time - this.speed.at);
      // One slow second is no news: the browser still compiles.
      const slow = SLOW * this.rate;
      this.behind = this.rate < Infinity && factor < slow && this.speed.factor < slow;
      this.speed = { at: time, simulated, factor };
    }
  }

  private take(event: PageEvent) {
    switch (event.kind) {
      case "frame":
        this.timeline.add(event);
        return;
      case "mark":
        this.marks.add(event);
        return;
      case "line":
        this.monitor.add(event.text);
        break;
      case "hint":
        this.notice(event.text, false);
        this.monitor.add(`[hint] ${event.text}`);
        break;
      case "mistake":
        this.monitor.add(`[mistake of the program] ${event.text}`);
        break;
      case "node":
        this.monitor.add(`[autopilot] ${event.text}`);
        break;
    }
  }

  private show(time: number) {
    const { snapshot } = this;
    this.outputs.show(snapshot.outputs);
    this.second.show(snapshot.second);
    this.plots.add(snapshot);
    // Arms and propellers move; for the others a third of the pictures are enough.
    if (time - this.restDrawnAt >= 3 * DRAW_MS) {
      this.restDrawnAt = time;
      this.showRest(time);
    }
  }

  private showRest(time: number) {
    const { snapshot } = this;
    this.showAllOutputs();
    this.timeline.draw(snapshot.now);
    this.plots.draw(snapshot.now);
    this.parameters.show(snapshot.client);
    this.faults.show(snapshot.faults);
    this.showNode();
    this.monitor.draw(time);
    setPressed(byId("vcd"), this.recordedTo !== null);
    if (this.recordedTo !== null && snapshot.now >= this.recordedTo) {
      this.recordedTo = null;
      download("wires.vcd", this.simulation.take_wires() as BlobPart);
    }
    const factor = this.speed.factor.toFixed(2);
    const paused = this.running ? "" : "paused, ";
    const late = this.running && this.behind ? ": this machine cannot keep up" : "";
    setText(byId("speed"), `${paused}${snapshot.now.toFixed(1)} s, ${factor} × real time${late}`);
    const load = (snapshot.load * 100).toFixed(1);
    const rate = snapshot.bit_rate / 1000;
    setText(byId("load"), `${load} % of ${rate} kbit/s, ${snapshot.error_frames} error frames`);
    setText(byId("sensor"), `${snapshot.sensor_c.toFixed(1)} °C`);
    byId("temperature").setAttribute("aria-valuetext", `${snapshot.sensor_c.toFixed(1)} °C`);
    byId("light").style.setProperty("--duty", String(snapshot.light));
    setText(byId("light-text"), `${Math.round(snapshot.light * 100)} %`);
    const { armed, safe, sweeps, name, command_type } = snapshot.autopilot;
    setPressed(byId("armed"), armed);
    setText(byId("armed"), armed ? "Armed" : "Disarmed");
    setPressed(byId("safe"), safe);
    setPressed(byId("sweep"), sweeps && !this.isHeld);
    setText(byId("autopilot-text"), `${name}, commands: ${command_type}`);
    if (snapshot.crash) {
      this.notice(`The program has crashed: ${snapshot.crash}. Power the board off and on.`);
    }
  }

  /** The node accepts another number of outputs only while the vehicle is disarmed. */
  private showAllOutputs() {
    const { now, outputs, autopilot, client } = this.snapshot;
    const used = outputs.filter((output) => output.width_us !== null).length;
    const isOffered = outputs.length > 1 && used === 1 && this.expand === null;
    byId("all-outputs").hidden = !isOffered;
    byId("four-motors").hidden = !isOffered || !client.parameters.some(({ name }) => name === "ESC_RATE");
    if (this.expand?.step === "disarm" && now >= this.expand.at) {
      this.expand.settings.forEach(([name, value]) => this.simulation.set_parameter(name, value));
      this.simulation.save_parameters();
      this.simulation.restart();
      this.expand = { ...this.expand, step: "arm", at: now + RESTART_S };
    } else if (this.expand?.step === "arm" && (used > 1 || now >= this.expand.at)) {
      this.expand = null;
      if (!autopilot.armed) {
        this.simulation.inject("disarm");
      }
    }
  }

  private showNode() {
    const { node, controller, client } = this.snapshot;
    if (node?.mode === "OPERATIONAL" && !client.busy) {
      this.begin();
    }
    const isSilent = !node || node.silent_s > 3;
    const health = byId("health");
    setText(health, isSilent ? "silent" : node.health);
    health.className = isSilent ? "badge" : `badge ${node.health}`;
    const silence = node ? `, last heard ${node.silent_s.toFixed(0)} s ago` : "not heard yet";
    const about = node ? `node ${node.id}: ${node.text}` : "";
    setText(byId("node-text"), isSilent ? about + silence : about);
    const conditions = (node?.conditions ?? []).join("|");
    const list = byId("conditions");
    if (list.dataset.shown !== conditions) {
      list.dataset.shown = conditions;
      list.replaceChildren(
        ...(node?.conditions ?? []).map(([text, advice]) => make("li", { textContent: `${text}: ${advice}` })),
      );
    }
    const { mode, error_state, tec, rec, lost, worst_us } = controller;
    setText(
      byId("controller"),
      `MCP2515: ${mode} mode, error ${error_state.toLowerCase()}, TEC ${tec}, REC ${rec}. ` +
        `${lost} frames lost; frames wait for the program ${worst_us.toFixed(0)} µs at most.`,
    );
  }

  /** Asks for the parameters of a node that has started, and then restores what a link has. */
  private begin() {
    if (this.readsParameters) {
      this.readsParameters = false;
      this.simulation.read_parameters();
      this.unsaved.forEach((value, name) => this.simulation.set_parameter(name, value));
    } else {
      this.faultsToBegin.splice(0).forEach((name) => this.simulation.inject(name));
    }
  }

  private showFrame(number: number) {
    try {
      this.detail.show(JSON.parse(this.simulation.frame(number)));
    } catch (error) {
      this.detail.hide();
      this.notice(String(error));
    }
  }

  private stepBit() {
    const bit = (CYCLES_PER_MS * 1000) / this.snapshot.bit_rate;
    this.simulation.advance(this.simulation.now() + bit);
  }

  /** Simulates up to the end of the next frame on the bus. */
  private stepFrame() {
    const { frames } = this.snapshot;
    const end = this.simulation.now() + STEP_MS * CYCLES_PER_MS;
    while (this.simulation.now() < end) {
      this.stepBit();
      if (this.simulation.frames() > frames) {
        return;
      }
    }
    this.notice(`No frame came in ${STEP_MS / 1000} s.`);
  }

  private listen() {
    const click = (id: string, act: () => void) => byId(id).addEventListener("click", act);
    click("run", () => {
      this.running = !this.running;
      setText(byId("run"), this.running ? "Pause" : "Run");
      byId("steps").hidden = this.running;
      this.synchronise();
    });
    click("step-frame", () => this.stepFrame());
    click("step-bit", () => this.stepBit());
    const rate = byId<HTMLSelectElement>("rate");
    rate.addEventListener("change", () => {
      this.rate = Number(rate.value);
      this.synchronise();
    });
    click("reboot", () => this.reboot());
    click("blank", () => {
      forget(nameOfEeprom(this.current));
      this.load(this.current);
    });
    click("sweep", () => {
      this.isHeld = false;
      this.simulation.sweep();
    });
    click("armed", () => this.simulation.inject("disarm"));
    click("safe", () => this.simulation.set_safe(!this.snapshot.autopilot.safe));
    click("reset", () => this.simulation.inject("reset"));
    click("read", () => {
      this.parameters.clear();
      this.simulation.read_parameters();
    });
    click("save", () => {
      this.unsaved.clear();
      this.simulation.save_parameters();
    });
    click("second", () => {
      this.hasSecond = !this.hasSecond;
      this.reboot();
      // Without one if this bus cannot have it.
      this.hasSecond = this.snapshot.second.length > 0;
      setPressed(byId("second"), this.hasSecond);
    });
    const expandTo = (settings: [string, number][]) => {
      if (this.snapshot.autopilot.armed) {
        this.simulation.inject("disarm");
      }
      this.expand = { step: "disarm", at: this.snapshot.now + DISARM_S, settings };
    };
    click("all-outputs", () => expandTo([["OUT_COUNT", this.snapshot.outputs.length]]));
    click("four-motors", () => expandTo(this.fourMotors));
    click("candump", () => download("bus.log", this.simulation.candump() as BlobPart));
    click("pcap", () => download("bus.pcap", this.simulation.pcap() as BlobPart));
    click("lines", () => download("monitor.txt", this.monitor.text()));
    click("vcd", () => {
      this.simulation.record_wires();
      this.recordedTo = this.snapshot.now + RECORDING_S;
    });
    click("link", () => void this.copyLink());
    click("erase", () => this.simulation.erase_parameters());
    click("restart", () => this.simulation.restart());
    const button = byId("button");
    const press = (pressed: boolean) => () => {
      setPressed(button, pressed);
      this.simulation.press_button(pressed);
    };
    const byKey = (act: () => void) => (event: KeyboardEvent) => {
      if (event.key === " " || event.key === "Enter") {
        act();
      }
    };
    button.addEventListener("pointerdown", press(true));
    button.addEventListener("pointerup", press(false));
    button.addEventListener("pointerleave", press(false));
    button.addEventListener("keydown", byKey(press(true)));
    button.addEventListener("keyup", byKey(press(false)));
    button.addEventListener("blur", press(false));
    const temperature = byId<HTMLInputElement>("temperature");
    temperature.addEventListener("input", () =>
      this.simulation.set_temperature(Number(temperature.value)),
    );
    const brightness = byId<HTMLInputElement>("brightness");
    brightness.addEventListener("input", () => this.simulation.set_light(Number(brightness.value)));
    const pattern = byId<HTMLSelectElement>("pattern");
    pattern.addEventListener("change", () => this.simulation.set_autopilot(pattern.value));
    byId("send").addEventListener("submit", (event) => {
      event.preventDefault();
      const text = byId<HTMLInputElement>("text");
      this.simulation.send_serial(text.value || "?");
      text.value = "";
    });
  }

  private listenToFiles() {
    const select = byId<HTMLSelectElement>("program");
    select.append(...PROGRAMS.map(({ name }) => new Option(name)));
    select.addEventListener("change", () => this.load(PROGRAMS[select.selectedIndex]));
    const open = async (file: File | undefined) => {
      if (file?.name.endsWith(".ino")) {
        this.notice(`${file.name} is the text of a sketch. The Arduino IDE makes the program of it: Sketch > Export compiled binary. Open the ELF or the HEX file that is beside it then.`);
      } else if (file) {
        const bytes = new Uint8Array(await file.arrayBuffer());
        if (SCRIPT.test(new TextDecoder().decode(bytes.slice(0, 1000)))) {
          this.play(file.name, bytes);
          return;
        }
        if (this.waitingLink?.program === file.name) {
          this.loadLink(this.waitingLink, bytes);
          return;
        }
        const autopilot = byId<HTMLSelectElement>("pattern").value;
        this.own = { name: file.name, bytes, autopilot, wiring: "" };
        this.load(this.own);
      }
    };
    const input = byId<HTMLInputElement>("file");
    input.addEventListener("change", () => {
      void open(input.files?.[0]);
      input.value = "";
    });
    const { classList } = document.body;
    document.addEventListener("dragover", (event) => {
      event.preventDefault();
      classList.add("drop");
    });
    document.addEventListener("dragleave", () => classList.remove("drop"));
    document.addEventListener("drop", (event) => {
      event.preventDefault();
      classList.remove("drop");
      const file = event.dataTransfer?.files[0];
      if (this.isShown) {
        void open(file);
      } else if (this.views.shown === "board") {
        void this.realBoard.open(file);
      }
    });
  }
}

new Page();
