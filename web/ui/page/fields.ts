// Plots of numbers in messages: any that a frame has in its text, several at once.

import { byId, make, setText } from "./dom";
import type { Marks } from "./marks";
import { Plot } from "./plots";
import type { FrameDetail, FrameEvent } from "./types";

const COLOURS = ["autopilot", "node", "tool", "ok", "warn", "error"];

/** Sender and type of a transfer: the first two words of its text. */
const keyOf = (text: string) => text.split(" ", 2).join(" ");

/** The numbers in the text of a transfer, each with its name: "id 1 unitless", or its place. */
export function numbersOf(text: string): [string, number][] {
  const found: [string, number][] = [];
  const seen = new Map<string, number>();
  // The last entry of a long text is cut.
  const entries = text.slice(keyOf(text).length).split(/[,;]/).filter((entry) => !entry.endsWith("…"));
  for (const entry of entries) {
    const pairs = [...entry.matchAll(/(?:([A-Za-z_]\w*) )?(?<![\w.])([-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?)(?![\w.:])/g)];
    const [first] = pairs;
    const prefix = first?.[1] === "id" && pairs.length > 1 ? `id ${first[2]} ` : "";
    for (const [, word = "value", number] of prefix ? pairs.slice(1) : pairs) {
      const count = (seen.get(prefix + word) ?? 0) + 1;
      seen.set(prefix + word, count);
      found.push([`${prefix}${word}${count > 1 ? ` ${count}` : ""}`, Number(number)]);
    }
  }
  return found;
}

interface FieldPlot {
  key: string;
  field: string;
  element: HTMLElement;
  plot: Plot;
}

export class Fields {
  private plots: FieldPlot[] = [];

  constructor(
    private readonly prefix: string,
    private readonly marks: Marks | null,
  ) {}

  /** Offers the numbers of a frame. */
  offer(frame: FrameDetail | null) {
    const buttons = numbersOf(frame?.text ?? "").map(([field, value]) => {
      const button = make("button", { type: "button", textContent: `Plot ${field}: ${value}` });
      button.addEventListener("click", () => this.begin(keyOf(frame!.text), field));
      return button;
    });
    byId(`${this.prefix}numbers`).replaceChildren(...buttons);
  }

  add({ text, end }: FrameEvent) {
    for (const { key, field, plot } of this.plots) {
      if (text.startsWith(`${key} `)) {
        const value = numbersOf(text).find(([name]) => name === field)?.[1];
        plot.add(end, value ?? null);
      }
    }
  }

  draw(now: number) {
    this.plots.forEach(({ plot }) => plot.draw(now));
  }

  clear() {
    this.offer(null);
    this.plots.forEach(({ plot }) => plot.clear());
  }

  private begin(key: string, field: string) {
    if (this.plots.some((plot) => plot.key === key && plot.field === field)) {
      return;
    }
    const title = `${key} ${field}`;
    const remove = make("button", { type: "button", textContent: "Remove" });
    remove.setAttribute("aria-label", `Remove ${title}`);
    const parent = make("div");
    const element = make("div", {}, make("div", { className: "row" }, make("h3", { textContent: title }), remove), parent);
    byId(`${this.prefix}field-place`).append(element);
    const colour = COLOURS[this.plots.length % COLOURS.length];
    const added = { key, field, element, plot: new Plot(parent, [field], [colour], null, true, this.marks) };
    this.plots.push(added);
    remove.addEventListener("click", () => {
      this.plots = this.plots.filter((plot) => plot !== added);
      element.remove();
      this.count();
    });
    this.count();
  }

  private count() {
    const { length } = this.plots;
    byId(`${this.prefix}field-none`).hidden = length > 0;
    setText(byId(`${this.prefix}part-more`), length > 0 ? `Log and plots (${length})` : "Log and plots");
  }
}
