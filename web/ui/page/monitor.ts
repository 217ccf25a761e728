// A serial monitor: lines as text, the latest of them on the screen, more of them for a download.

/** Lines on the screen. */
const SHOWN = 400;
/** Lines that are kept at least, if there were so many. */
const KEPT = 100_000;
/** A longer line is broken: without ends of lines, as with a wrong baud rate, it would not end. */
const LONGEST = 500;
/** Real time between two additions to the screen, which make the browser lay it out. */
const DRAW_MS = 150;

export class Monitor {
  /** Lines that are not on the screen yet. */
  private waiting: string[] = [];
  private all: string[] = [];
  private drawnAt = 0;
  private follows = true;

  constructor(private readonly element: HTMLElement) {
    element.addEventListener("scroll", () => {
      this.follows = element.scrollTop + element.clientHeight > element.scrollHeight - 20;
    });
  }

  add(line: string) {
    this.waiting.push(line);
    this.all.push(line);
    if (this.all.length > 2 * KEPT) {
      this.all.splice(0, KEPT);
    }
    if (this.waiting.length > 2 * SHOWN) {
      this.waiting.splice(0, SHOWN);
    }
  }

  clear() {
    [this.waiting, this.all] = [[], []];
    this.follows = true;
    this.element.replaceChildren();
  }

  /** All lines that are kept. */
  text() {
    return this.all.join("\n");
  }

  /** Shows what is new, at most every DRAW_MS. `time` is that of performance.now(). */
  draw(time: number) {
    if (this.waiting.length === 0 || time - this.drawnAt < DRAW_MS) {
      return;
    }
    this.drawnAt = time;
    const { element } = this;
    element.append(...this.waiting.map((line) => `${line}\n`));
    this.waiting = [];
    while (element.childNodes.length > SHOWN) {
      element.firstChild!.remove();
    }
    if (this.follows) {
      element.scrollTop = element.scrollHeight;
    }
  }
}

/** Splits bytes that arrive in pieces into lines. What is no UTF-8 becomes a sign for that. */
export class Lines {
  private readonly decoder = new TextDecoder();
  private rest = "";

  /** The lines that end in these bytes, without control characters. */
  take(bytes: Uint8Array) {
    this.rest += this.decoder.decode(bytes, { stream: true });
    const lines = this.rest.split(/\r\n|\n|\r(?!$)/);
    this.rest = lines.pop()!;
    while (this.rest.length > LONGEST) {
      lines.push(this.rest.slice(0, LONGEST));
      this.rest = this.rest.slice(LONGEST);
    }
    return lines.map((line) => line.replace(/[\u0000-\u0008\u000b-\u001f\u007f-\u009f]/g, "\u2022"));
  }
}
