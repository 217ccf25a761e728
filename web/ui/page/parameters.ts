// The parameters of a node in a form. web/src/dialogue.rs reads and sets them.

import DOCUMENTED from "parameters.json";
import { byId, make, setText } from "./dom";
import type { Client, Parameter } from "./types";

interface Row {
  input: HTMLInputElement | HTMLSelectElement;
  /** The value that the node reported last; null while a new one is on its way. */
  reported: string | null;
}

const TYPES: Record<Parameter["kind"], string> = {
  integer: "whole numbers",
  real: "numbers",
  boolean: "true or false",
  text: "text",
  none: "nothing",
};

export class Parameters {
  private rows = new Map<string, Row>();
  private readonly table: HTMLElement;
  private readonly status: HTMLElement;
  private message = "";

  /** `prefix` begins the IDs of its elements. `set` throws if the text is no value. */
  constructor(
    prefix: string,
    private readonly set: (name: string, text: string) => void,
  ) {
    this.table = byId(`${prefix}table`);
    this.status = byId(`${prefix}client`);
  }

  clear() {
    this.rows.clear();
    this.table.replaceChildren();
  }

  /** `isOurs` is true if docs/parameters.md describes the parameters. */
  show(client: Client, isOurs = true) {
    const message = client.busy ? `${client.message} …` : client.message;
    // What is wrong with a value stays until the node says something else.
    if (message !== this.message) {
      this.message = message;
      setText(this.status, message);
    }
    for (const parameter of client.parameters) {
      const row = this.rows.get(parameter.name) ?? this.add(parameter, isOurs);
      if (row.reported !== parameter.value) {
        row.reported = parameter.value;
        row.input.value = parameter.value ?? "";
      }
    }
  }

  private add(parameter: Parameter, isOurs: boolean): Row {
    const { name, kind, value, min, max, default: initial } = parameter;
    const input = this.input(parameter);
    input.setAttribute("aria-label", name);
    input.disabled = kind === "none";
    const row: Row = { input, reported: value };
    input.addEventListener("input", () => input.removeAttribute("aria-invalid"));
    input.addEventListener("change", () => this.change(parameter, row));
    const { unit = "", meaning = "" } = (isOurs ? DOCUMENTED[name] : undefined) ?? {};
    const about = make("th", { scope: "row" }, name, make("small", { textContent: meaning }));
    const range = min === null && max === null ? "" : `${min ?? ""} to ${max ?? ""}`;
    const cells = [input, unit, range, initial ?? ""];
    this.table.append(make("tr", {}, about, ...cells.map((cell) => make("td", {}, cell))));
    this.rows.set(name, row);
    return row;
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

  private change({ name, kind, value, min, max }: Parameter, row: Row) {
    const { input } = row;
    const refuse = (why: string) => {
      // It stays marked until the next value.
      input.setAttribute("aria-invalid", "true");
      setText(this.status, `${why}: it stays ${row.reported ?? value}.`);
      input.value = row.reported ?? value ?? "";
    };
    if (!input.validity.valid || (input.value === "" && kind !== "text")) {
      const range = min === null || max === null ? "" : ` from ${min} to ${max}`;
      refuse(`${name} takes ${TYPES[kind]}${range}`);
      return;
    }
    try {
      this.set(name, input.value);
      // The node's answer has the value that it took.
      row.reported = null;
    } catch (error) {
      refuse(String(error));
    }
  }
}
