// The views of the page: each <main> with an ID "view-NAME" has a tab with an ID "tab-NAME", and the
// address #view=NAME.

import { byId } from "./dom";

const PREFIX = "view-";

export class Views {
  private readonly views = [...document.querySelectorAll<HTMLElement>(`main[id^="${PREFIX}"]`)];
  private readonly listeners: ((name: string) => void)[] = [];
  /** Name of the view on the screen. */
  shown = "";

  constructor() {
    for (const name of this.names()) {
      byId(`tab-${name}`).addEventListener("click", () => {
        if (name !== this.shown) {
          history.pushState(null, "", name === this.names()[0] ? "#" : `#view=${name}`);
          this.show(name);
        }
      });
    }
    window.addEventListener("hashchange", () => this.follow());
  }

  /** Calls `listener` with the name of the view now and whenever another is shown. */
  onChange(listener: (name: string) => void) {
    this.listeners.push(listener);
    if (this.shown !== "") {
      listener(this.shown);
    }
  }

  /** Shows the view of the address; the first without one. */
  follow() {
    const name = new URLSearchParams(location.hash.slice(1)).get("view");
    this.show(this.names().find((known) => known === name) ?? this.names()[0]);
  }

  private names() {
    return this.views.map(({ id }) => id.slice(PREFIX.length));
  }

  private show(name: string) {
    if (name === this.shown) {
      return;
    }
    this.shown = name;
    document.body.dataset.view = name;
    for (const view of this.views) {
      view.hidden = view.id !== PREFIX + name;
    }
    for (const known of this.names()) {
      const tab = byId(`tab-${known}`);
      if (known === name) {
        tab.setAttribute("aria-current", "page");
      } else {
        tab.removeAttribute("aria-current");
      }
    }
    this.listeners.forEach((listener) => listener(name));
  }
}
