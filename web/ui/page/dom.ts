// Short forms of the document's methods.

/** The element with this ID, which index.html has. */
export function byId<T extends HTMLElement = HTMLElement>(id: string): T {
  const element = document.getElementById(id);
  if (!element) {
    throw new Error(`index.html has no element "${id}"`);
  }
  return element as T;
}

/** Calls `act` when the element with this ID is clicked. */
export function onClick(id: string, act: () => void) {
  byId(id).addEventListener("click", act);
}

export function setText(element: HTMLElement, text: string) {
  if (element.textContent !== text) {
    element.textContent = text;
  }
}

/** Sets a text, in which an address becomes a link. */
export function setLinkedText(element: HTMLElement, text: string) {
  if (element.textContent !== text) {
    const parts = text.split(/(https:\/\/\S+)/);
    const link = (href: string) => make("a", { href, target: "_blank", rel: "noopener", textContent: href });
    element.replaceChildren(...parts.map((part) => (part.startsWith("https://") ? link(part) : part)));
  }
}

export function setPressed(element: HTMLElement, pressed: boolean) {
  element.setAttribute("aria-pressed", String(pressed));
}

export function make<K extends keyof HTMLElementTagNameMap>(
  name: K,
  properties: Partial<HTMLElementTagNameMap[K]> = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = Object.assign(document.createElement(name), properties);
  element.append(...children);
  return element;
}

/** Attributes that have the IDs of other elements. */
const REFERENCES = ["id", "aria-labelledby", "aria-controls"];

/** Puts a copy of a template of index.html into an element. `prefix` begins the IDs of the copy. */
export function mount(template: string, parent: HTMLElement, prefix: string) {
  const copy = byId<HTMLTemplateElement>(template).content.cloneNode(true) as DocumentFragment;
  for (const name of REFERENCES) {
    for (const element of copy.querySelectorAll(`[${name}]`)) {
      element.setAttribute(name, prefix + element.getAttribute(name));
    }
  }
  parent.append(copy);
}

/** Part of the time after which the rest of it is known well enough. */
const KNOWN = 0.05;

/** The time that is left of what began at a time of performance.now(), in words; empty at first. */
export function timeLeft(begun: number, done: number, all: number) {
  const seconds = ((performance.now() - begun) / 1000) * (all / done - 1);
  return done > KNOWN * all ? `, ${Math.ceil(seconds)} s left` : "";
}

/** Has the browser save a file. */
export function download(name: string, data: BlobPart) {
  const url = URL.createObjectURL(new Blob([data]));
  make("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 1000);
}

/** A colour of app.css. */
export function colour(name: string) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

/** The context of a canvas, scaled so that a unit is a CSS pixel, and the size in units. */
export function prepare(canvas: HTMLCanvasElement, width: number, height: number) {
  const scale = window.devicePixelRatio || 1;
  const [w, h] = [Math.round(width * scale), Math.round(height * scale)];
  if (canvas.width !== w || canvas.height !== h) {
    canvas.width = w;
    canvas.height = h;
  }
  const context = canvas.getContext("2d")!;
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.clearRect(0, 0, width, height);
  return context;
}
