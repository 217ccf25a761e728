// Tabs of a view: each button of a tablist shows the panel that it names in aria-controls, and hides
// the others.

import { byId } from "./dom";

/** Steps to another tab by the arrow keys. */
const STEPS: Record<string, number> = { ArrowLeft: -1, ArrowRight: 1 };

export class Tabs {
  private readonly tabs: HTMLElement[];

  constructor(list: string) {
    this.tabs = [...byId(list).querySelectorAll<HTMLElement>("[role=tab]")];
    this.tabs.forEach((tab, index) => {
      tab.addEventListener("click", () => this.show(tab));
      tab.addEventListener("keydown", ({ key }) => {
        const next = this.tabs[index + (STEPS[key] ?? NaN)];
        if (next) {
          next.focus();
          this.show(next);
        }
      });
    });
    this.show(this.tabs[0]);
  }

  show(shown: HTMLElement) {
    for (const tab of this.tabs) {
      tab.setAttribute("aria-selected", String(tab === shown));
      byId(tab.getAttribute("aria-controls")!).hidden = tab !== shown;
    }
  }
}
