// The view "Simulated board": runs the simulation in slices between two pictures, and has its parts
// draw what it says.

import { Program, Simulation, choices, faults } from "pkg/web.js";
import { Autopilot } from "./autopilot";
import { BoardView } from "./board";
import { BusPanel } from "./bus-panel";
import { Clock } from "./clock";
import { byId, onClick, setPressed, setText } from "./dom";
import { encode, forget, keep, kept } from "./eeprom";
import { Faults } from "./faults";
import { type Link, toHash } from "./link";
import { Marks } from "./marks";
import { Monitor } from "./monitor";
import { NodeView } from "./node";
import { type Cure, explain } from "./own-board";
import { Parameters } from "./parameters";
import { Plots } from "./plots";
import { ProgramChoice, type Runner } from "./program-choice";
import { type Choice, PROGRAMS, SECOND, nameOfEeprom } from "./programs";
import { TakeAway } from "./take-away";
import { Tabs } from "./tabs";
import type { Lane } from "./timeline";
import type { Toured } from "./tour";
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
/** Parts whose controls reach the node only while its time goes on. */
const ACTING = "#command, #board, #faults, #more-faults, #send, #panel-parameters";
/** What a press there acts on: an empty place is none. */
const PRESSED = "button, label, [role=button]";
const PAUSED = "The time is paused: what you do takes effect when you press Run.";
const NO_LOADER = new Uint8Array();

export class SimulatedView implements Runner, Toured {
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
  /** Parameters and faults of a link, which are set and begin when the node runs. */
  private restores: Pick<Link, "parameters" | "faults"> = { parameters: [], faults: [] };

  private readonly tabs = new Tabs("parts");
  private readonly clock = new Clock(
    this,
    () => {
      this.look();
      this.bus.chooseNewest();
    },
    () => this.bus.nextBit(),
  );
  private readonly monitor = new Monitor(byId("monitor"));
  private readonly marks = new Marks();
  private readonly plots = new Plots(this.marks);
  private readonly bus = new BusPanel(
    "",
    LANES,
    this.marks,
    (number) => this.simulation.frame(number),
    (frame) => this.board.carry(frame),
  );
  private readonly autopilot = new Autopilot(this);
  private readonly board = new BoardView(this);
  private readonly node = new NodeView();
  private readonly takeAway = new TakeAway(this, () => this.monitor.text());
  private readonly parameters = new Parameters("", () => this.simulation, () => "simulated-node");
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
      next = new Simulation(program, choice.loader ?? NO_LOADER, eeprom, choice.autopilot, this.board.corner);
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
    this.restores = { parameters: [], faults: [] };
    // The thesis's node has none.
    this.readsParameters = this.current.autopilot !== "thesis";
    this.programs.show(this.current);
    this.autopilot.begin(this.current.autopilot);
    this.board.begin();
    this.takeAway.begin();
    for (const part of [this.monitor, this.bus, this.plots, this.marks, this.parameters]) {
      part.clear();
    }
    this.synchronise();
    setText(byId("node-text"), "");
  }

  restore(choice: Choice, link: Link) {
    this.board.corner = link.corner;
    this.load(choice);
    this.restores = link;
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

  /** Copies an address that restores what runs. */
  private async copyLink() {
    const hash = toHash({
      program: this.current.name,
      pattern: this.pattern,
      corner: this.board.corner,
      wiring: this.current.wiring ?? "",
      eeprom: encode(this.simulation.eeprom()),
      // A link has numbers.
      parameters: this.parameters.unsaved.map(([name, text]) => [name, Number(text)]),
      faults: this.snapshot.faults,
    });
    try {
      await navigator.clipboard.writeText(new URL(hash, location.href).href);
      this.notice("A link that restores what runs now is copied.", false);
    } catch {
      history.replaceState(null, "", hash);
      this.notice("The address of this page restores what runs now. Copy it from there.", false);
    }
  }

  // ---- what it shows ----

  notice(text: string, isError = true, cure: Cure | null = null) {
    byId("notice").classList.toggle("error", isError);
    byId("notice").hidden = text === "";
    setText(byId("notice-text"), text);
    const mend = byId("notice-fix");
    mend.hidden = cure === null;
    setText(mend, cure?.title ?? "");
    mend.onclick = () => cure && this.programs.mend(cure);
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
      this.look();
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

  setFault(name: string, isActive: boolean) {
    if (this.snapshot.faults.includes(name) !== isActive) {
      this.simulation.inject(name);
    }
  }

  reveal(part: string) {
    const panel = byId(part).closest("[role=tabpanel]");
    if (panel) {
      this.tabs.show(byId(panel.getAttribute("aria-labelledby")!));
    }
    return part === "parameters" ? (this.parameters.find("OUT1_TRIM") ?? byId(part)) : byId(part);
  }

  /** Takes what is new. */
  private look() {
    this.snapshot = JSON.parse(this.simulation.snapshot());
    for (const event of JSON.parse(this.simulation.take_events()) as PageEvent[]) {
      this.take(event);
    }
  }

  private take(event: PageEvent) {
    switch (event.kind) {
      case "frame":
        this.bus.add(event);
        return;
      case "mark":
        this.marks.add(event);
        return;
      case "line":
        this.monitor.add(event.text);
        break;
      case "hint": {
        const { text, cure } = explain(event.text);
        this.notice(text, false, cure);
        this.monitor.add(`[hint] ${text}`);
        break;
      }
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
    const load = (snapshot.load * 100).toFixed(1);
    const rate = snapshot.bit_rate / 1000;
    this.bus.draw(snapshot.now, `${load} % of ${rate} kbit/s, ${snapshot.error_frames} error frames`);
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
    if (snapshot.crash) {
      this.notice(`The program has crashed: ${snapshot.crash}. Power the board off and on.`);
    }
  }

  /** Asks for the parameters of a node that has started, and then restores what a link has. */
  private ask() {
    if (this.readsParameters) {
      this.readsParameters = false;
      this.simulation.read_parameters();
      this.restores.parameters.forEach(([name, value]) => this.simulation.set_parameter(name, value));
    } else {
      this.restores.faults.forEach((name) => this.simulation.inject(name));
      this.restores = { parameters: [], faults: [] };
    }
  }

  private listen() {
    for (const kind of ["click", "change", "submit"]) {
      byId("view-simulated").addEventListener(kind, ({ target }) => {
        const acts = kind !== "click" || (target as Element).closest(PRESSED);
        // What a control has just said, such as an error, stays.
        if (acts && !this.clock.isRunning && byId("notice").hidden && (target as Element).closest(ACTING)) {
          this.notice(PAUSED, false);
        }
      });
    }
    onClick("run", () => {
      if (byId("notice-text").textContent === PAUSED) {
        this.notice("");
      }
    });
    onClick("reboot", () => this.reboot());
    byId("corner").addEventListener("change", () => this.reboot());
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
    byId("send").addEventListener("submit", (event) => {
      event.preventDefault();
      const text = byId<HTMLInputElement>("text");
      this.simulation.send_serial(text.value || "?");
      text.value = "";
    });
  }
}
