// The parameters of a node: a table with search and groups, and what can be done with all of them.
// web/src/dialogue.rs reads and sets them.

import DOCUMENTED from "parameters.json";
import { byId, download, make, mount, onClick, setText } from "./dom";
import type { Client, Parameter } from "./types";

/** What asks a node: the simulation, or the real bus. */
export interface Asked {
  read_parameters(): void;
  /** Throws if the text is no value. */
  write_parameter(name: string, text: string): void;
  save_parameters(): void;
  erase_parameters(): void;
  restart(): void;
  load_parameters(file: string): void;
  parameter_file(): string;
}

interface Row {
  element: HTMLTableRowElement;
  input: HTMLInputElement | HTMLSelectElement;
  slider: HTMLInputElement | null;
  reset: HTMLButtonElement;
  mark: HTMLElement;
  parameter: Parameter;
  /** The value that the node reported last; null while a new one is on its way. */
  reported: string | null;
  group: string;
  /** What the search looks at. */
  text: string;
}

const TYPES: Record<Parameter["kind"], string> = {
  integer: "whole numbers",
  real: "numbers",
  boolean: "true or false",
  text: "text",
  none: "nothing",
};

/** A range of at most so many steps has a slider, and one of few steps needs none. */
const [SLIDER_STEPS, FEW_STEPS] = [2500, 3];

/** Groups by the first word of a name; another word is a group of its own. */
const GROUPS: Record<string, string> = {
  CAN: "CAN", OUT: "Outputs", MOT: "Motors", ESC: "Motors", TEMP: "Temperature", PWR1: "Power", BATT: "Battery",
  RPM: "Revolutions", RELAY: "Relays", LIGHT: "Lights", WARN: "Health", ERROR: "Health", CRIT: "Health",
  ARM: "Safety", SAFE: "Safety", TELEM: "Telemetry", STATS: "Telemetry",
};

function groupOf(name: string) {
  const output = /^OUT(\d)_/.exec(name);
  const word = name.split(/[_.]/)[0];
  return output ? `Output ${output[1]}` : (GROUPS[word] ?? word);
}

export class Parameters {
  private rows = new Map<string, Row>();
  private groups = new Map<string, HTMLElement>();
  /** The values that the node has saved, as far as the page knows: those that it read first. */
  private readonly saved = new Map<string, string | null>();
  private message = "";
  private problems = "";
  /** The button that shows these parameters, which counts what is not saved. */
  private readonly tab: HTMLElement;
  private readonly search: HTMLInputElement;
  private readonly group: HTMLSelectElement;
  private readonly onlyChanged: HTMLInputElement;

  /** `prefix` begins the IDs of its elements. `name` is for the file with the parameters. */
  constructor(
    private readonly prefix: string,
    private readonly asked: () => Asked,
    name: () => string,
  ) {
    mount("parameters-template", byId(`${prefix}panel-parameters`), prefix);
    this.tab = byId(`${prefix}part-parameters`);
    this.search = this.part("search");
    this.group = this.part("group");
    this.onlyChanged = this.part("only-changed");
    for (const filter of [this.search, this.group, this.onlyChanged]) {
      filter.addEventListener("input", () => this.filter());
    }
    const click = (id: string, act: () => void) => onClick(prefix + id, act);
    click("read", () => this.read());
    click("save", () => asked().save_parameters());
    click("erase", () => asked().erase_parameters());
    click("restart", () => asked().restart());
    click("to-file", () => download(`${name()}.parm`, asked().parameter_file()));
    const from: HTMLInputElement = this.part("from-file");
    from.addEventListener("change", () => {
      void from.files?.[0]?.text().then((text) => this.load(text));
      from.value = "";
    });
  }

  private part<T extends HTMLElement>(id: string) {
    return byId<T>(this.prefix + id);
  }

  /** Forgets the node. */
  clear() {
    this.saved.clear();
    this.empty();
  }

  /** What was set, but not saved. */
  get unsaved(): [string, string][] {
    return [...this.rows.values()]
      .filter((row) => this.isUnsaved(row))
      .map(({ parameter, reported }) => [parameter.name, reported!]);
  }

  /** The buttons that a node without an answer, or a busy one, does not have. */
  enable(isUsable: boolean, isBusy: boolean) {
    for (const id of ["read", "save", "erase", "restart"]) {
      this.part<HTMLButtonElement>(id).disabled = !isUsable;
    }
    this.part<HTMLInputElement>("from-file").disabled = !isUsable || isBusy;
    this.part<HTMLButtonElement>("to-file").disabled = isBusy || this.rows.size === 0;
  }

  say(text: string) {
    setText(this.part("client"), text);
  }

  /** `isOurs` is true if docs/parameters.md describes the parameters. */
  show(client: Client, isOurs = true) {
    const message = client.busy ? `${client.message} …` : client.message;
    // What is wrong with a value stays until the node says something else.
    if (message !== this.message) {
      this.message = message;
      this.say(message);
      this.follow(client.message);
    }
    for (const parameter of client.parameters) {
      const row = this.rows.get(parameter.name) ?? this.add(parameter, isOurs);
      if (row.reported !== parameter.value) {
        row.reported = parameter.value;
        row.input.value = parameter.value ?? "";
        this.mark(row);
      }
    }
    this.showProblems(client.problems);
  }

  /** Reveals the row of a parameter, and returns it; null if it is not read. */
  find(name: string) {
    [this.search.value, this.group.value, this.onlyChanged.checked] = ["", "", false];
    this.filter();
    return this.rows.get(name)?.element ?? null;
  }

  private empty() {
    this.rows.clear();
    this.groups.forEach((body) => body.remove());
    this.groups.clear();
    this.group.replaceChildren(this.group.options[0]);
    this.count();
  }

  private read() {
    this.empty();
    this.asked().read_parameters();
  }

  /** What a save, an erase or a restart makes of the values. The words are those of dialogue.rs. */
  private follow(message: string) {
    if (message.startsWith("saved:")) {
      this.rows.forEach(({ parameter, reported }) => this.saved.set(parameter.name, reported));
      this.rows.forEach((row) => this.mark(row));
    } else if (message.startsWith("erased:") || message === "the node restarts") {
      this.saved.clear();
      this.read();
    }
  }

  private load(text: string) {
    try {
      this.asked().load_parameters(text);
    } catch (error) {
      this.say(`Nothing was set: ${String(error)}.`);
    }
  }

  /** What of a file the node has not. */
  private showProblems(problems: string[]) {
    const shown = problems.join("\n");
    if (shown !== this.problems) {
      this.problems = shown;
      this.part("problems").replaceChildren(...problems.map((textContent) => make("li", { textContent })));
    }
  }

  private add(parameter: Parameter, isOurs: boolean): Row {
    const { name, kind, value, min, max, default: initial } = parameter;
    const input = this.input(parameter);
    const slider = this.slider(parameter);
    input.setAttribute("aria-label", name);
    input.disabled = kind === "none";
    const { unit = "", meaning = "" } = (isOurs ? DOCUMENTED[name] : undefined) ?? {};
    const reset = make("button", { type: "button", textContent: "Reset", title: `Set ${name} to ${initial}` });
    const mark = make("span", { className: "mark", textContent: "not saved" });
    const range = min === null && max === null ? "" : `${min ?? ""} to ${max ?? ""}`;
    const cells = [
      make("td", {}, input, ...(slider ? [slider] : []), mark),
      ...[unit, range].map((textContent) => make("td", { textContent })),
      make("td", {}, `${initial ?? ""} `, reset),
      make("td", { textContent: meaning }),
    ];
    const element = make("tr", {}, make("th", { scope: "row", textContent: name }), ...cells);
    const group = groupOf(name);
    const text = `${name} ${meaning} ${group}`.toLowerCase();
    const row: Row = { element, input, slider, reset, mark, parameter, reported: value, group, text };
    input.addEventListener("input", () => input.removeAttribute("aria-invalid"));
    input.addEventListener("change", () => this.change(row));
    slider?.addEventListener("input", () => (input.value = slider.value));
    slider?.addEventListener("change", () => this.change(row));
    reset.addEventListener("click", () => {
      input.value = initial ?? "";
      this.change(row);
    });
    this.body(group).append(element);
    this.rows.set(name, row);
    if (!this.saved.has(name)) {
      this.saved.set(name, value);
    }
    this.mark(row);
    return row;
  }

  /** The part of the table for a group. */
  private body(group: string) {
    const known = this.groups.get(group);
    if (known) {
      return known;
    }
    const head = make("th", { colSpan: 6, scope: "rowgroup", textContent: group });
    const body = make("tbody", {}, make("tr", { className: "group" }, head));
    this.part("table").append(body);
    this.groups.set(group, body);
    this.group.append(new Option(group));
    return body;
  }

  private input({ kind, value, min, max }: Parameter) {
    if (kind === "boolean") {
      const select = make("select", {}, new Option("true"), new Option("false"));
      select.value = value ?? "";
      return select;
    }
    if (kind === "text" || kind === "none") {
      return make("input", { type: "text", maxLength: 128, value: value ?? "" });
    }
    const input = make("input", { type: "number", value: value ?? "" });
    input.step = kind === "real" ? "any" : "1";
    input.min = min ?? "";
    input.max = max ?? "";
    return input;
  }

  private slider({ name, kind, value, min, max }: Parameter) {
    const steps = Number(max) - Number(min);
    if (kind !== "integer" || min === null || max === null || steps > SLIDER_STEPS || steps < FEW_STEPS) {
      return null;
    }
    const slider = make("input", { type: "range", min, max, value: value ?? "" });
    slider.setAttribute("aria-label", `${name}, slider`);
    return slider;
  }

  private isUnsaved({ parameter: { name }, reported }: Row) {
    return reported !== null && reported !== this.saved.get(name);
  }

  /** Shows how the value of a row stands to the saved one and to the default. */
  private mark(row: Row) {
    const { parameter, reported, slider, reset, mark } = row;
    mark.hidden = !this.isUnsaved(row);
    reset.hidden = parameter.default === null || reported === parameter.default;
    if (slider) {
      slider.value = reported ?? slider.value;
    }
    this.filter([row]);
    this.count();
  }

  private count() {
    const unsaved = this.unsaved.length;
    setText(this.tab, unsaved > 0 ? `Parameters (${unsaved} not saved)` : "Parameters");
    this.part("save").classList.toggle("primary", unsaved > 0);
    const shown = [...this.rows.values()].filter(({ element }) => !element.hidden).length;
    setText(this.part("shown"), this.rows.size > 0 ? `${shown} of ${this.rows.size}` : "");
  }

  private filter(rows: Iterable<Row> = this.rows.values()) {
    const wanted = this.search.value.trim().toLowerCase();
    for (const { element, text, group, reset } of rows) {
      const isOther = this.group.value !== "" && this.group.value !== group;
      element.hidden = isOther || !text.includes(wanted) || (this.onlyChanged.checked && reset.hidden);
    }
    for (const body of this.groups.values()) {
      body.hidden = ![...body.children].some((row) => row.className !== "group" && !(row as HTMLElement).hidden);
    }
    this.count();
  }

  private change(row: Row) {
    const { input, parameter } = row;
    const { name, kind, value, min, max } = parameter;
    const refuse = (why: string) => {
      // It stays marked until the next value.
      input.setAttribute("aria-invalid", "true");
      this.say(`${why}: it stays ${row.reported ?? value}.`);
      input.value = row.reported ?? value ?? "";
      this.mark(row);
    };
    if (!input.validity.valid || (input.value === "" && kind !== "text")) {
      const range = min === null || max === null ? "" : ` from ${min} to ${max}`;
      refuse(`${name} takes ${TYPES[kind]}${range}`);
      return;
    }
    try {
      this.asked().write_parameter(name, input.value);
      // The node's answer has the value that it took.
      row.reported = null;
    } catch (error) {
      refuse(String(error));
    }
  }
}
