// The bits of one frame as on an oscilloscope, its fields, and the SPI transaction that fetched it.

import { byId, colour, make, prepare, setText } from "./dom";
import type { FrameDetail } from "./types";

const BIT_WIDTH = 9;
const HIGH = 34;
const LOW = 84;
const HEIGHT = 120;
const BANDS: [RegExp, string][] = [
  [/^ID/, "#6f42c1"],
  [/^data/, "#0b6bcb"],
  [/^CRC$/, "#b58900"],
  [/^ACK$/, "#1a7f4b"],
];
const STUFF = "#c2410c";
const PLAIN = "#8894a3";

function bandOf(name: string) {
  return BANDS.find(([pattern]) => pattern.test(name))?.[1] ?? PLAIN;
}

function hex(bytes: number[]) {
  return bytes.map((byte) => byte.toString(16).padStart(2, "0").toUpperCase()).join(" ");
}

export class Detail {
  private readonly element: HTMLElement;
  private readonly scope: HTMLCanvasElement;
  private frame: FrameDetail | null = null;
  /** True from when it opens until `reveal`. */
  private hasOpened = false;
  /** Index of the bit that is marked; -1 for none. */
  private marked = -1;

  /** `prefix` begins the IDs of its elements. `note` is for a bus of which no SPI is known. */
  constructor(
    private readonly prefix: string,
    note: string,
  ) {
    setText(byId(`${prefix}spi`), note);
    this.element = byId(`${prefix}detail`);
    this.scope = byId<HTMLCanvasElement>(`${prefix}scope`);
  }

  show(detail: FrameDetail | null) {
    this.hasOpened = detail !== null && (this.hasOpened || this.frame === null);
    this.frame = detail;
    this.marked = -1;
    this.element.hidden = detail === null;
    if (detail === null) {
      return;
    }
    const length = detail.length_us.toFixed(0);
    const title = `${detail.time}, ${detail.from}: ${detail.text}`;
    setText(byId(`${this.prefix}frame-title`), `${title} (${detail.count} bits, ${length} µs)`);
    this.drawBits(detail);
    setText(byId(`${this.prefix}bit`), "");
    this.listFields(detail);
    this.describeSpi(detail);
  }

  /** Scrolls to the bits if they have just opened: they may be below the screen. */
  reveal() {
    if (this.hasOpened) {
      this.hasOpened = false;
      this.scope.scrollIntoView({ block: "nearest" });
    }
  }

  /** Marks the next bit. Returns its time in seconds; null after the last, or without a frame. */
  nextBit() {
    const { frame } = this;
    if (!frame?.wire || this.marked + 1 >= frame.wire.bits.length) {
      return null;
    }
    this.marked++;
    this.drawBits(frame);
    const { parentElement } = this.scope;
    parentElement!.scrollLeft = this.marked * BIT_WIDTH - parentElement!.clientWidth / 2;
    const [level, isStuff, field] = frame.wire.bits[this.marked];
    const kind = isStuff ? "stuff bit" : frame.wire.fields[field][0];
    const name = level === null ? "not known" : level === 0 ? "dominant" : "recessive";
    setText(byId(`${this.prefix}bit`), `Bit ${this.marked + 1} of ${frame.wire.bits.length}: ${kind}, ${name}`);
    return Number.parseFloat(frame.time) + (this.marked * frame.length_us) / frame.count / 1e6;
  }

  private drawBits({ wire, text }: FrameDetail) {
    const bits = wire?.bits ?? [];
    const width = bits.length * BIT_WIDTH + 20;
    this.scope.style.width = `${width}px`;
    this.scope.style.height = `${HEIGHT}px`;
    const context = prepare(this.scope, width, HEIGHT);
    if (!wire) {
      return;
    }
    const stuffed = bits.filter((bit) => bit[1]).length;
    const unknown = bits.some(([level]) => level === null) ? ", the level of ACK not known" : "";
    this.scope.setAttribute("aria-label", `${bits.length} bits of ${text}, ${stuffed} of them stuff bits${unknown}`);
    const [ink, dim] = ["ink", "dim"].map(colour);
    context.font = "11px system-ui, sans-serif";
    let labelled = -1;
    let labelEnd = 0;
    bits.forEach(([, isStuff, field], at) => {
      const x = 10 + at * BIT_WIDTH;
      const name = wire.fields[field][0];
      context.globalAlpha = isStuff ? 0.45 : 0.18;
      context.fillStyle = isStuff ? STUFF : bandOf(name);
      context.fillRect(x, HIGH - 12, BIT_WIDTH, LOW - HIGH + 24);
      context.globalAlpha = 1;
      if (field !== labelled) {
        labelled = field;
        context.fillStyle = dim;
        context.fillRect(x, 20, 1, LOW - 8);
        if (x >= labelEnd) {
          context.fillText(name, x + 2, 14);
          labelEnd = x + context.measureText(name).width + 6;
        }
      }
    });
    if (this.marked >= 0) {
      context.strokeStyle = colour("error");
      context.lineWidth = 2;
      context.strokeRect(10 + this.marked * BIT_WIDTH, HIGH - 12, BIT_WIDTH, LOW - HIGH + 24);
    }
    context.strokeStyle = ink;
    context.lineWidth = 1.6;
    context.fillStyle = ink;
    context.beginPath();
    bits.forEach(([level], at) => {
      const x = 10 + at * BIT_WIDTH;
      const y = level === 0 ? LOW : HIGH;
      if (at === 0) {
        context.moveTo(x, HIGH);
      }
      if (level === null) {
        // Both levels.
        context.fillText("?", x + 2, (LOW + HIGH) / 2 + 4);
        context.moveTo(x, LOW);
        context.lineTo(x + BIT_WIDTH, LOW);
        context.moveTo(x, HIGH);
      }
      context.lineTo(x, y);
      context.lineTo(x + BIT_WIDTH, y);
    });
    context.stroke();
    context.fillStyle = dim;
    context.fillText("recessive above, dominant below", 10, HEIGHT - 6);
  }

  private listFields({ wire }: FrameDetail) {
    const list = (id: string, fields: [string, string][]) => {
      const rows = fields.map(([name, value]) =>
        make("div", {}, make("dt", { textContent: name }), make("dd", { textContent: value })),
      );
      byId(this.prefix + id).replaceChildren(...rows);
    };
    let bytes = 0;
    const numbered = (name: string) => (name === "data" ? `data byte ${++bytes}` : name);
    const fields = (wire?.fields ?? []).filter(([, value]) => value !== "");
    list("fields", fields.map(([name, value]) => [numbered(name), value]));
    list("meaning", wire?.meaning ?? []);
  }

  private describeSpi({ spi, from }: FrameDetail) {
    if (spi === undefined) {
      return;
    }
    const said = byId(`${this.prefix}spi`);
    if (!spi) {
      const sent = from === "node" ? "The node sent this frame." : "The node did not fetch this frame";
      const why = from === "node" ? "" : ": a filter rejected it, or it is not fetched yet.";
      setText(said, sent + why);
      return;
    }
    said.replaceChildren(
      `The node fetched it ${spi.after_us.toFixed(1)} µs after its last bit with ${spi.name}, in ` +
        `${spi.took_us.toFixed(1)} µs. MOSI `,
      make("code", { textContent: hex(spi.mosi) }),
      ", MISO ",
      make("code", { textContent: hex(spi.miso) }),
    );
  }
}
