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

  /** `prefix` begins the IDs of its elements. */
  constructor(private readonly prefix: string) {
    this.element = byId(`${prefix}detail`);
    this.scope = byId<HTMLCanvasElement>(`${prefix}scope`);
  }

  hide() {
    this.element.hidden = true;
  }

  show(detail: FrameDetail) {
    this.element.hidden = false;
    const length = detail.length_us.toFixed(0);
    const title = `${detail.time}, ${detail.from}: ${detail.text}`;
    setText(byId(`${this.prefix}frame-title`), `${title} (${detail.count} bits, ${length} µs)`);
    this.drawBits(detail);
    this.listFields(detail);
    this.describeSpi(detail);
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
    if (!spi) {
      const sent = from === "node" ? "The node sent this frame." : "The node did not fetch this frame";
      const why = from === "node" ? "" : ": a filter rejected it, or it is not fetched yet.";
      setText(byId("spi"), sent + why);
      return;
    }
    byId("spi").replaceChildren(
      `The node fetched it ${spi.after_us.toFixed(1)} µs after its last bit with ${spi.name}, in ` +
        `${spi.took_us.toFixed(1)} µs. MOSI `,
      make("code", { textContent: hex(spi.mosi) }),
      ", MISO ",
      make("code", { textContent: hex(spi.miso) }),
    );
  }
}
