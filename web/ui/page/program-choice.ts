// What the simulated board runs: a program of the page, a file of the user, or what a link says.

import { byId } from "./dom";
import { isKept, keep } from "./eeprom";
import { type Link, fromHash, toHash } from "./link";
import { type Choices, type Cure, OwnBoard } from "./own-board";
import { type Choice, PROGRAMS } from "./programs";
import type { World } from "./world";

/** The first letter of a script: a time in brackets, or a comment. A program begins otherwise. */
const SCRIPT = /^\s*[(#]/;

/** The state of an entry of the history whose link was opened: one that is pasted has none. */
const OPENED = "opened";

/** What the view does with the choice. */
export interface Runner extends World {
  /** Starts a program. */
  load(choice: Choice): void;
  /** Starts what a link says. */
  restore(choice: Choice, link: Link): void;
  play(name: string, script: Uint8Array): void;
  /** Pattern of the autopilot for the next program. */
  readonly pattern: string;
}

export class ProgramChoice {
  private readonly select = byId<HTMLSelectElement>("program");
  private readonly ownBoard: OwnBoard;
  /** The file that the user opened last. */
  private own: Choice | null = null;
  /** A link whose program the user has to choose. */
  private waitingLink: Link | null = null;
  /** The link that was loaded last. */
  private loaded = "";

  constructor(
    private readonly runner: Runner,
    choices: Choices,
  ) {
    this.select.append(...PROGRAMS.map(({ name }) => new Option(name)));
    this.select.addEventListener("change", () => runner.load(PROGRAMS[this.select.selectedIndex]));
    const input = byId<HTMLInputElement>("file");
    input.addEventListener("change", () => {
      void this.open(input.files?.[0]);
      input.value = "";
    });
    this.ownBoard = new OwnBoard(choices, () => {
      if (this.own) {
        this.own = { ...this.own, wiring: this.ownBoard.wiring() };
        runner.load(this.own);
      }
    });
    window.addEventListener("hashchange", () => this.openLink());
  }

  /** The list names the program that runs, also one from a file. */
  show(current: Choice) {
    const { select } = this;
    const index = PROGRAMS.findIndex(({ name }) => name === current.name);
    while (select.options.length > PROGRAMS.length) {
      select.options[PROGRAMS.length].remove();
    }
    if (index < 0) {
      select.append(new Option(current.name));
    }
    select.selectedIndex = index < 0 ? PROGRAMS.length : index;
    this.ownBoard.show(current.wiring ?? null);
  }

  /** Wires the board of the user's program anew. */
  mend(cure: Cure) {
    this.ownBoard.mend(cure);
  }

  /** A HEX file does not say its chip. */
  askForChip(choice: Choice) {
    this.runner.notice(`${choice.name} does not say for which chip it is: choose chip or board.`, false);
    this.ownBoard.show(choice.wiring ?? "");
    this.ownBoard.ask();
  }

  /** Opens a file of the user: a program, or a script. */
  async open(file: File | undefined) {
    if (!file) {
      return;
    }
    if (file.name.endsWith(".ino")) {
      this.runner.notice(`${file.name} is the text of a sketch. The Arduino IDE makes the program of it: Sketch > Export compiled binary. Open the ELF or the HEX file that is beside it then.`);
      return;
    }
    const bytes = new Uint8Array(await file.arrayBuffer());
    if (SCRIPT.test(new TextDecoder().decode(bytes.slice(0, 1000)))) {
      this.runner.play(file.name, bytes);
    } else if (this.waitingLink?.program === file.name) {
      this.loadLink(this.waitingLink, bytes);
    } else {
      this.own = { name: file.name, bytes, autopilot: this.runner.pattern, wiring: "" };
      this.runner.load(this.own);
    }
  }

  /** Loads what the address has. */
  openLink() {
    const link = fromHash(location.hash);
    const program = PROGRAMS.find(({ name }) => name === link?.program);
    // An entry of the history that was opened before: the user is back from another view.
    const isBack = history.state === OPENED;
    history.replaceState(OPENED, "");
    if (link && isBack && toHash(link) === this.loaded) {
      // What runs goes on.
    } else if (link && program) {
      this.loadLink(link, program.bytes);
    } else if (link) {
      this.waitingLink = link;
      this.runner.notice(`This link is for the program ${link.program}: choose the file, with "Own ELF or HEX".`, false);
    }
  }

  private loadLink(link: Link, bytes: Uint8Array) {
    // The user's own EEPROM of the program stays.
    const keptAs = toHash(link);
    const isReload = isKept(keptAs);
    if (!isReload) {
      keep(keptAs, link.eeprom);
    }
    this.loaded = keptAs;
    const { program: name, pattern, wiring } = link;
    const known = PROGRAMS.find((program) => program.name === name);
    const isOwn = known === undefined;
    const autopilot = pattern || (known?.autopilot ?? this.runner.pattern);
    const choice = { ...known, name, bytes, autopilot, keptAs, wiring: isOwn ? wiring : undefined };
    this.own = isOwn ? choice : null;
    // After a reload the board has what was saved, and no more, as after any loss of its supply.
    this.runner.restore(choice, isReload ? { ...link, parameters: [], faults: [] } : link);
  }
}
