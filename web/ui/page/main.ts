// The page: runs the simulation in slices between two pictures, and draws what it says.

import "./app.css";
import "uplot/dist/uPlot.min.css";
import wasm from "binary/web_bg.wasm";
import { Program, Simulation, faults, initSync } from "pkg/web.js";
import { Processor } from "../avr/processor";
import { Detail } from "./detail";
import { byId, setPressed, setText } from "./dom";
import { Faults } from "./faults";
import { Outputs } from "./outputs";
import { Parameters } from "./parameters";
import { Plots } from "./plots";
import { PROGRAMS } from "./programs";
import { Timeline } from "./timeline";
import type { PageEvent, Snapshot } from "./types";

const CYCLES_PER_MS = 16_000;
/** Simulated time of one slice, between two looks at the clock. */
const SLICE_MS = 1;
/** Real time that the simulation may take between two pictures. */
const BUDGET_MS = 14;
/** Real time that the simulation may be behind before the page says that it cannot keep up. */
const LAG_MS = 250;
const SLOW = 0.97;
const LINES = 400;
/** Real time between two pictures of what is drawn. */
const DRAW_MS = 30;
/** Real time between two additions to the serial monitor, which make the browser lay it out. */
const MONITOR_MS = 150;
/** Simulated time in which the node hears that it is disarmed: ArmingStatus comes twice a second. */
const DISARM_S = 0.7;
/** Simulated time after which the node has saved and restarted, or did not accept the number. */
const RESTART_S = 10;

initSync({ module: wasm.slice() });

class Page {
  private simulation!: Simulation;
  private snapshot!: Snapshot;
  private running = true;
  /** Real time up to which the simulation should be, less the simulated time. */
  private offset = 0;
  private behind = false;
  private speed = { at: 0, simulated: 0, factor: 1 };
  private drawnAt = 0;
  /** Lines that the serial monitor does not show yet. */
  private lines: string[] = [];
  private linesAt = 0;
  private followsLines = true;
  /** Commands of the sliders, by actuator. */
  private readonly held = new Map<number, number>();
  /** What "Use all outputs" does next, and when; null when it does nothing. */
  private expand: { step: "disarm" | "arm"; at: number } | null = null;
  private current = PROGRAMS[0];

  private readonly plots = new Plots();
  private readonly detail = new Detail();
  private readonly timeline = new Timeline((number) => this.showFrame(number));
  private readonly outputs = new Outputs(byId("outputs"), (actuator, deflection) => {
    this.held.set(actuator, deflection);
    this.simulation.hold(actuator, deflection);
  });
  private readonly parameters = new Parameters((name, value) =>
    this.simulation.set_parameter(name, value),
  );
  private readonly faults = new Faults(JSON.parse(faults()), (name) => this.simulation.inject(name));

  constructor() {
    this.listen();
    this.listenToFiles();
    this.load(PROGRAMS[0]);
    requestAnimationFrame((time) => this.picture(time));
  }

  /** Starts a program; a wrong file leaves the present one running. */
  private load(choice: (typeof PROGRAMS)[number]) {
    let next: Simulation;
    try {
      const program = Program.parse(choice.bytes);
      const flash = program.flash();
      const processor = new Processor(flash, program.ram_bytes(), program.eeprom());
      next = new Simulation(program, processor, choice.autopilot);
    } catch (error) {
      this.notice(`${choice.name} cannot run here: ${String(error)}`);
      return;
    }
    this.notice("");
    this.simulation?.free();
    this.simulation = next;
    this.current = choice;
    this.held.clear();
    this.expand = null;
    byId<HTMLSelectElement>("pattern").value = choice.autopilot;
    byId<HTMLInputElement>("temperature").value = "20";
    byId<HTMLInputElement>("brightness").value = "0";
    this.lines = [];
    this.followsLines = true;
    byId("monitor").replaceChildren();
    this.timeline.clear();
    this.plots.clear();
    this.parameters.clear();
    this.detail.hide();
    this.offset = performance.now();
    this.speed = { at: this.offset, simulated: 0, factor: 1 };
    this.snapshot = JSON.parse(next.snapshot());
    setText(byId("wiring"), this.snapshot.board);
    setText(byId("node-text"), "");
    byId("button").hidden = !this.snapshot.has_button;
    byId("light-box").hidden = !this.snapshot.has_light;
  }

  private notice(text: string) {
    byId("notice").hidden = text === "";
    setText(byId("notice"), text);
  }

  private picture(time: number) {
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
    requestAnimationFrame((next) => this.picture(next));
  }

  /** Simulates up to the present moment, as far as the budget allows. */
  private run(time: number) {
    const start = performance.now();
    const wanted = time - this.offset;
    let simulated = this.simulation.now() / CYCLES_PER_MS;
    while (simulated < wanted && performance.now() - start < BUDGET_MS) {
      simulated += SLICE_MS;
      this.simulation.advance(simulated * CYCLES_PER_MS);
    }
    if (wanted - simulated > LAG_MS) {
      // What was missed is not made up for.
      this.offset += wanted - simulated;
    }
    if (time - this.speed.at > 1000) {
      const factor = (simulated - this.speed.simulated) / (time - this.speed.at);
      // One slow second is no news: the browser still compiles.
      this.behind = factor < SLOW && this.speed.factor < SLOW;
      this.speed = { at: time, simulated, factor };
    }
  }

  private take(event: PageEvent) {
    switch (event.kind) {
      case "frame":
        this.timeline.add(event);
        return;
      case "line":
        this.lines.push(event.text);
        break;
      case "mistake":
        this.lines.push(`[mistake of the program] ${event.text}`);
        break;
      case "node":
        this.lines.push(`[autopilot] ${event.text}`);
        break;
    }
  }

  private show(time: number) {
    const { snapshot } = this;
    this.outputs.show(snapshot.outputs);
    this.showAllOutputs();
    this.timeline.draw(snapshot.now);
    this.plots.add(snapshot, this.held.get(1) ?? snapshot.autopilot.deflection);
    this.plots.draw(snapshot.now);
    this.parameters.show(snapshot);
    this.faults.show(snapshot.faults);
    this.showNode();
    this.showLines(time);
    const factor = this.speed.factor.toFixed(2);
    const paused = this.running ? "" : "paused, ";
    const late = this.running && this.behind ? ": this machine cannot keep up" : "";
    setText(byId("speed"), `${paused}${snapshot.now.toFixed(1)} s, ${factor} × real time${late}`);
    const load = (snapshot.load * 100).toFixed(1);
    const rate = snapshot.bit_rate / 1000;
    setText(byId("load"), `${load} % of ${rate} kbit/s, ${snapshot.error_frames} error frames`);
    setText(byId("sensor"), `${snapshot.sensor_c.toFixed(1)} °C`);
    byId("light").style.setProperty("--duty", String(snapshot.light));
    setText(byId("light-text"), `${Math.round(snapshot.light * 100)} %`);
    const { armed, safe, silent, sweeps, name, command_type } = snapshot.autopilot;
    setPressed(byId("armed"), armed);
    setText(byId("armed"), armed ? "Armed" : "Disarmed");
    setPressed(byId("safe"), safe);
    setPressed(byId("silent"), silent);
    setPressed(byId("sweep"), sweeps && this.held.size === 0);
    setText(byId("autopilot-text"), `${name}, commands: ${command_type}`);
    if (snapshot.crash) {
      this.notice(`The program has crashed: ${snapshot.crash}. Power the board off and on.`);
    }
  }

  /** The node accepts another number of outputs only while the vehicle is disarmed. */
  private showAllOutputs() {
    const { now, outputs, autopilot } = this.snapshot;
    const used = outputs.filter((output) => output.width_us !== null).length;
    byId("all-outputs").hidden = outputs.length === 1 || used !== 1 || this.expand !== null;
    if (this.expand?.step === "disarm" && now >= this.expand.at) {
      this.simulation.set_parameter("OUT_COUNT", outputs.length);
      this.simulation.save_parameters();
      this.simulation.restart();
      this.expand = { step: "arm", at: now + RESTART_S };
    } else if (this.expand?.step === "arm" && (used > 1 || now >= this.expand.at)) {
      this.expand = null;
      if (!autopilot.armed) {
        this.simulation.inject("disarm");
      }
    }
  }

  private showNode() {
    const { node, controller } = this.snapshot;
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
        ...(node?.conditions ?? []).map((text) =>
          Object.assign(document.createElement("li"), { textContent: text }),
        ),
      );
    }
    const { mode, error_state, tec, rec, lost, worst_us } = controller;
    setText(
      byId("controller"),
      `MCP2515: ${mode} mode, error ${error_state.toLowerCase()}, TEC ${tec}, REC ${rec}. ` +
        `${lost} frames lost; frames wait for the program ${worst_us.toFixed(0)} µs at most.`,
    );
  }

  private showLines(time: number) {
    if (this.lines.length === 0 || time - this.linesAt < MONITOR_MS) {
      return;
    }
    this.linesAt = time;
    const monitor = byId("monitor");
    monitor.append(...this.lines.map((line) => `${line}\n`));
    this.lines = [];
    while (monitor.childNodes.length > LINES) {
      monitor.firstChild!.remove();
    }
    if (this.followsLines) {
      monitor.scrollTop = monitor.scrollHeight;
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

  private listen() {
    const click = (id: string, act: () => void) => byId(id).addEventListener("click", act);
    click("run", () => {
      this.running = !this.running;
      setText(byId("run"), this.running ? "Pause" : "Run");
      this.offset = performance.now() - this.simulation.now() / CYCLES_PER_MS;
      this.speed = { ...this.speed, at: performance.now(), simulated: this.snapshot.now * 1000 };
    });
    click("reboot", () => this.load(this.current));
    click("sweep", () => {
      this.held.clear();
      this.simulation.sweep();
    });
    click("armed", () => this.simulation.inject("disarm"));
    click("silent", () => this.simulation.inject("silence"));
    click("safe", () => this.simulation.set_safe(!this.snapshot.autopilot.safe));
    click("reset", () => this.simulation.inject("reset"));
    click("read", () => {
      this.parameters.clear();
      this.simulation.read_parameters();
    });
    click("save", () => this.simulation.save_parameters());
    click("all-outputs", () => {
      if (this.snapshot.autopilot.armed) {
        this.simulation.inject("disarm");
      }
      this.expand = { step: "disarm", at: this.snapshot.now + DISARM_S };
    });
    click("erase", () => this.simulation.erase_parameters());
    click("restart", () => this.simulation.restart());
    const button = byId("button");
    const press = (pressed: boolean) => () => this.simulation.press_button(pressed);
    button.addEventListener("pointerdown", press(true));
    button.addEventListener("pointerup", press(false));
    button.addEventListener("pointerleave", press(false));
    button.addEventListener("keydown", press(true));
    button.addEventListener("keyup", press(false));
    button.addEventListener("blur", press(false));
    const temperature = byId<HTMLInputElement>("temperature");
    temperature.addEventListener("input", () =>
      this.simulation.set_temperature(Number(temperature.value)),
    );
    const brightness = byId<HTMLInputElement>("brightness");
    brightness.addEventListener("input", () => this.simulation.set_light(Number(brightness.value)));
    const pattern = byId<HTMLSelectElement>("pattern");
    pattern.addEventListener("change", () => this.simulation.set_autopilot(pattern.value));
    const monitor = byId("monitor");
    monitor.addEventListener("scroll", () => {
      this.followsLines = monitor.scrollTop + monitor.clientHeight > monitor.scrollHeight - 20;
    });
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
      if (file) {
        const bytes = new Uint8Array(await file.arrayBuffer());
        this.load({ name: file.name, bytes, autopilot: byId<HTMLSelectElement>("pattern").value });
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
      void open(event.dataTransfer?.files[0]);
    });
  }
}

new Page();
