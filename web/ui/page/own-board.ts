// The board of the user's own program: chip, board, CAN board, CS, INT, crystal and bit rate. What
// is not chosen is as the file says, or as the choice before implies.

import { byId, make } from "./dom";

/** Values and titles of each choice, from `choices` of web/src/api.rs. */
export type Choices = Record<string, [string, string][]>;

const LABELS: Record<string, string> = {
  mcu: "Chip",
  board: "Board",
  shield: "CAN board",
  cs: "CS",
  int: "INT",
  crystal: "Crystal",
  bit_rate: "Bit rate",
};

export class OwnBoard {
  private readonly selects = new Map<string, HTMLSelectElement>();
  private readonly element = byId("own");

  constructor(choices: Choices, changed: () => void) {
    for (const [name, label] of Object.entries(LABELS)) {
      const options = choices[name].map(([value, title]) => new Option(title, value));
      const select = make("select", { id: `own-${name}` }, new Option("as the file", ""), ...options);
      select.addEventListener("change", changed);
      this.selects.set(name, select);
      this.element.append(make("label", {}, `${label} `, select));
    }
  }

  /** Shows the choices in `wiring`, a JSON object; hides them for null. */
  show(wiring: string | null) {
    this.element.hidden = wiring === null;
    const chosen = JSON.parse(wiring || "{}") as Record<string, string>;
    this.selects.forEach((select, name) => (select.value = chosen[name] ?? ""));
  }

  /** Asks for a choice. */
  ask() {
    this.selects.get("mcu")?.focus();
  }

  /** The choices as a JSON object. */
  wiring() {
    const chosen = [...this.selects].filter(([, select]) => select.value !== "");
    return JSON.stringify(Object.fromEntries(chosen.map(([name, { value }]) => [name, value])));
  }
}
