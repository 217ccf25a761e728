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

/** An option of `sim` in a hint, with or without its value. */
const OPTION = / \(--([a-z-]+)(?: (\w+))?\)/g;

/** A choice that mends what a hint is about. */
export interface Cure {
  name: string;
  value: string;
  /** What it does, in words. */
  title: string;
}

/** A hint of the simulator without the options of its command line, and what mends it. */
export function explain(hint: string): { text: string; cure: Cure | null } {
  let cure: Cure | null = null;
  const text = hint.replaceAll(OPTION, (_, option: string, value?: string) => {
    const name = option.replace("-", "_");
    if (value === undefined) {
      return ` ("${LABELS[name]}" above)`;
    }
    cure = { name, value, title: `Wire ${LABELS[name]} to ${value}` };
    return "";
  });
  return { text, cure };
}

export class OwnBoard {
  private readonly selects = new Map<string, HTMLSelectElement>();
  private readonly element = byId("own");

  constructor(
    choices: Choices,
    private readonly changed: () => void,
  ) {
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

  /** Chooses what mends a mistake. */
  mend({ name, value }: Cure) {
    this.selects.get(name)!.value = value;
    this.changed();
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
