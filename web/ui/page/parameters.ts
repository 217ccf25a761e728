// The parameters of the node in a form. The tool in web/src/client.rs reads and sets them.

import { byId, make, setText } from "./dom";
import type { Parameter, Snapshot } from "./types";

interface Row {
  input: HTMLInputElement;
  /** The value that the node reported last. */
  reported: number | null;
}

export class Parameters {
  private rows = new Map<string, Row>();
  private readonly table = byId("table");

  constructor(private readonly set: (name: string, value: number) => void) {}

  clear() {
    this.rows.clear();
    this.table.replaceChildren();
  }

  show({ client }: Snapshot) {
    if (client.message) {
      setText(byId("client"), client.busy ? `${client.message} …` : client.message);
    }
    for (const parameter of client.parameters) {
      const row = this.rows.get(parameter.name) ?? this.add(parameter);
      if (row.reported !== parameter.value) {
        row.reported = parameter.value;
        row.input.value = String(parameter.value);
      }
    }
  }

  private add({ name, value, min, max, default: initial }: Parameter): Row {
    const input = make("input", { type: "number", value: String(value) });
    input.setAttribute("aria-label", name);
    input.min = String(min);
    input.max = String(max);
    const row: Row = { input, reported: value };
    input.addEventListener("change", () => {
      if (input.reportValidity() && input.value !== "") {
        this.set(name, Number(input.value));
        // The node's answer has the value that it took.
        row.reported = null;
      }
    });
    const cells = [name, input, `${min} to ${max}`, `${initial}`];
    this.table.append(make("tr", {}, ...cells.map((cell) => make("td", {}, cell))));
    this.rows.set(name, row);
    return row;
  }
}
