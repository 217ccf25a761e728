// The view "Simulated board": runs the simulation in slices between two pictures, and has its parts
// draw what it says.

import { Program, Simulation, choices, faults } from "pkg/web.js";
import { Autopilot } from "./autopilot";
import { BoardView } from "./board";
import { Clock } from "./clock";
import { Detail } from "./detail";
import { byId, onClick, setPressed, setText } from "./dom";
import { encode, forget, keep, kept } from "./eeprom";
import { Faults } from "./faults";
import { type Link, toHash } from "./link";
import { Marks } from "./marks";
import { Monitor } from "./monitor";
import { NodeView } from "./node";
import { Parameters } from "./parameters";
import { Plots } from "./plots";
import { ProgramChoice, type Runner } from "./program-choice";
import { type Choice, PROGRAMS, SECOND, nameOfEeprom } from "./programs";
import { TakeAway } from "./take-away";
import { type Lane, Timeline } from "./timeline";
import type { PageEvent, Snapshot } from "./types";

/** Real time between two pictures of what is drawn. */
const DRAW_MS = 30;
/** Real time between two looks at the EEPROM, which the browser keeps. */
const KEEP_MS = 1000;
/** Senders on the time line. */
const LANES: Lane[] = [
  { name: "autopilot", colour: "autopilot" },
  { name: "node", colour: "node" },
  { name: "tool", colour: "tool" },
  { name: "others", colour: "other" },
];
const NO_LOADER = new Uint8Array();

export class SimulatedView implements Runner {
  simulation!: Simulation;
  snapshot!: Snapshot;
  private current: Choice = PROGRAMS[0];
  /** True if there is a second board. */
  private hasSecond = false;
  private drawnAt = 0;
  private restDrawnAt = 0;
  private keptAt = 0;
  /** True until the parameters of the started node are asked for. */
  private readsParameters = true;
  /** Parameters that were set, but not saved. */
  private readonly unsaved = new Map<string, number>();
  /** Faults of a link, which begin when the node runs. */
  private faultsToBegin: string[] = [];

  private readonly clock = new Clock(this);
  private readonly monitor = new Monitor(byId("monitor"));
  private readonly marks = new Marks();
  private readonly plots = new Plots(this.marks);
  private readonly detail = new Detail("");
  private readonly timeline = new Timeline("", LANES, this.marks, (number) => this.showFrame(number));
  private readonly autopilot = new Autopilot(this);
  private readonly board = new BoardView(this);
  private readonly node = new NodeView();
  private readonly takeAway = new TakeAway(this, () => this.monitor.text());
  private readonly parameters = new Parameters("", (name, text) => {
    this.simulation.write_parameter(name, text);
    // A link has numbers.
    if (Number.isFinite(Number(text))) {
      this.unsaved.set(name, Number(text));
    }
  });
  private readonly faults = new Faults(JSON.parse(faults()), (name) => this.simulation.inject(name));
  private readonly programs = new ProgramChoice(this, JSON.parse(choices()));

  constructor() {
    this.listen();
    this.load(PROGRAMS[0]);
    this.programs.openLink();
  }

  // ---- what runs ----

  /** Starts a program with the EEPROM that it left; a wrong file leaves the present one running. */
  load(choice: Choice) {
    let next: Simulation;
    try {
      const program = Program.parse(choice.bytes, choice.wiring || "{}");
      if (!program.names_chip()) {
        this.programs.askForChip(choice);
        return;
      }
      const eeprom = kept(nameOfEeprom(choice), program.eeprom());
      next = new Simulation(program, choice.loader ?? NO_LOADER, eeprom, choice.autopilot);
      if (this.hasSecond) {
        next.add_second(Program.parse(SECOND, "{}"));
      }
    } catch (error) {
      this.notice(`${choice.name} cannot run here: ${String(error)}`);
      this.programs.show(this.current);
      return;
    }
    this.notice("");
    this.simulation?.free();
    this.simulation = next;
    this.current = choice;
    this.snapshot = JSON.parse(next.snapshot());
    this.begin();
  }

  /** Shows a simulation that begins. */
  private begin() {
    this.unsaved.clear();
    this.faultsToBegin = [];
    // The thesis's node has none.
    this.readsParameters = this.current.autopilot !== "thesis";
    this.programs.show(this.current);
    this.autopilot.begin(this.current.autopilot);
    this.board.begin(this.snapshot);
    this.takeAway.begin();
    for (const part of [this.monitor, this.timeline, this.plots, this.marks, this.parameters]) {
      part.clear();
    }
    this.detail.hide();
    this.synchronise();
    setText(byId("node-text"), "");
  }

  restore(choice: Choice, link: Link) {
    this.load(choice);
    link.parameters.forEach(([name, value]) => this.unsaved.set(name, value));
    this.faultsToBegin = link.faults;
  }

  /** Plays a script from power-on, from which its times count. */
  play(name: string, script: Uint8Array) {
    this.reboot();
    try {
      this.notice(`${name} plays: ${this.simulation.play(script)}.`, false);
    } catch (error) {
      this.notice(`${name}: ${String(error)}`);
    }
  }

  private reboot() {
    this.keepEeprom();
    this.load(this.current);
  }

  private keepEeprom() {
    keep(nameOfEeprom(this.current), encode(this.simulation.eeprom()));
  }

  get pattern() {
    return this.autopilot.chosen;
  }

  /** Opens a file of the user. */
  open(file: File | undefined) {
    return this.programs.open(file);
  }

  /** The address of the page gets what runs. */
  private async copyLink() {
    const hash = toHash({
      program: this.current.name,
      pattern: this.pattern,
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

  // ---- what it shows ----

  notice(text: string, isError = true) {
    byId("notice").classList.toggle("error", isError);
    byId("notice").hidden = text === "";
    setText(byId("notice"), text);
  }

  /** Real time goes on from the present simulated time. */
  synchronise() {
    this.clock.synchronise();
  }

  /** Simulates up to the present moment, and draws what is new. */
  draw(time: number) {
    this.clock.run(time);
    if (time - this.drawnAt >= DRAW_MS) {
      this.drawnAt = time;
      this.snapshot = JSON.parse(this.simulation.snapshot());
      for (const event of JSON.parse(this.simulation.take_events()) as PageEvent[]) {
        this.take(event);
      }
      this.autopilot.move(this.snapshot);
      this.plots.add(this.snapshot);
      // Arms and propellers move; for the others a third of the pictures are enough.
      if (time - this.restDrawnAt >= 3 * DRAW_MS) {
        this.restDrawnAt = time;
        this.showRest(time);
      }
    }
    if (time - this.keptAt >= KEEP_MS) {
      this.keptAt = time;
      this.keepEeprom();
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

  private showRest(time: number) {
    const { snapshot } = this;
    this.autopilot.show(snapshot);
    this.timeline.draw(snapshot.now);
    this.plots.draw(snapshot.now);
    this.parameters.show(snapshot.client);
    this.faults.show(snapshot.faults);
    if (snapshot.node?.mode === "OPERATIONAL" && !snapshot.client.busy) {
      this.ask();
    }
    this.node.show(snapshot);
    this.monitor.draw(time);
    this.board.show(snapshot);
    this.takeAway.show();
    this.clock.show();
    const load = (snapshot.load * 100).toFixed(1);
    const rate = snapshot.bit_rate / 1000;
    setText(byId("load"), `${load} % of ${rate} kbit/s, ${snapshot.error_frames} error frames`);
    if (snapshot.crash) {
      this.notice(`The program has crashed: ${snapshot.crash}. Power the board off and on.`);
    }
  }

  /** Asks for the parameters of a node that has started, and then restores what a link has. */
  private ask() {
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

  private listen() {
    onClick("reboot", () => this.reboot());
    onClick("blank", () => {
      forget(nameOfEeprom(this.current));
      this.load(this.current);
    });
    onClick("second", () => {
      this.hasSecond = !this.hasSecond;
      this.reboot();
      // Without one if this bus cannot have it.
      this.hasSecond = this.snapshot.second.length > 0;
      setPressed(byId("second"), this.hasSecond);
    });
    onClick("link", () => void this.copyLink());
    onClick("read", () => {
      this.parameters.clear();
      this.simulation.read_parameters();
    });
    onClick("save", () => {
      this.unsaved.clear();
      this.simulation.save_parameters();
    });
    onClick("erase", () => this.simulation.erase_parameters());
    onClick("restart", () => this.simulation.restart());
    byId("send").addEventListener("submit", (event) => {
      event.preventDefault();
      const text = byId<HTMLInputElement>("text");
      this.simulation.send_serial(text.value || "?");
      text.value = "";
    });
  }
}
