// The LogMessages of all nodes: kept, filtered, and as a file.

import { byId, download, make, onClick } from "./dom";
import type { FrameEvent } from "./types";

/** Messages that are kept, and that are on the screen. */
const [KEPT, SHOWN] = [20_000, 200];
const LEVELS = ["DEBUG", "INFO", "WARNING", "ERROR"];

interface Message {
  at: string;
  node: string;
  level: string;
  text: string;
}

export class Log {
  private messages: Message[] = [];
  private isDrawn = true;
  private readonly level: HTMLSelectElement;
  private readonly search: HTMLInputElement;

  constructor(private readonly prefix: string) {
    this.level = byId(`${prefix}log-level`);
    this.search = byId(`${prefix}log-search`);
    for (const filter of [this.level, this.search]) {
      filter.addEventListener("input", () => (this.isDrawn = false));
    }
    onClick(`${prefix}log-download`, () => {
      const lines = this.chosen().map(({ at, node, level, text }) => `${at} ${node} ${level} ${text}\n`);
      download("log.txt", lines.join(""));
    });
  }

  clear() {
    this.messages = [];
    this.isDrawn = false;
  }

  add({ end, log }: FrameEvent) {
    if (log) {
      const text = log.source === "" ? log.text : `${log.source}: ${log.text}`;
      this.messages.push({ at: end.toFixed(3), node: String(log.node ?? "?"), level: log.level, text });
      this.messages.splice(0, this.messages.length - KEPT);
      this.isDrawn = false;
    }
  }

  /** The newest is first. */
  draw() {
    if (this.isDrawn) {
      return;
    }
    this.isDrawn = true;
    const rows = this.chosen().slice(-SHOWN).reverse();
    const cells = ({ at, node, level, text }: Message) =>
      [`${at} s`, node, level, text].map((textContent) => make("td", { textContent }));
    const lines = rows.map((message) => make("tr", { className: message.level }, ...cells(message)));
    byId(`${this.prefix}log-lines`).replaceChildren(...lines);
    byId(`${this.prefix}log-empty`).hidden = this.messages.length > 0;
  }

  private chosen() {
    const least = LEVELS.indexOf(this.level.value);
    const wanted = this.search.value.trim().toLowerCase();
    return this.messages.filter(
      ({ node, level, text }) =>
        LEVELS.indexOf(level) >= least && (node === wanted || text.toLowerCase().includes(wanted)),
    );
  }
}
