// The board as a picture that is alive: bus, CAN board, Arduino and what is wired to it, with the
// pins of avr-specs/boards.toml, which the simulation has. A wire that can be pulled or shorted is a
// button for that fault; the wires that carry the chosen frame light up.

import { byId, setPressed } from "./dom";
import type { FrameDetail, Snapshot, Wiring } from "./types";

/** Upper edge of the first wire of the MCP2515, and of the first output, and their distances. */
const [TOP, STEP, OUTPUT_STEP] = [30, 19, 16];
/** Edges of the CAN board, of the Arduino and of the picture. */
const [LEFT, SHIELD, ARDUINO, RIGHT, END] = [170, 300, 400, 570, 700];
/** A sender, and the left edge of its place on the bus. */
const STATIONS: [string, number][] = [
  ["tool", 32],
  ["others", 94],
];

/** `fault`: what happens to the wire when it is pressed. */
interface Wire {
  name: string;
  pin: string;
  kind: string;
  fault?: string;
}

/** The wires of the MCP2515, as in scripts/wires.py. The pins of the SPI are those of the chip. */
function controller({ cs, int }: Wiring): Wire[] {
  return [
    { name: "VCC", pin: "5V", kind: "plus", fault: "chip-power" },
    { name: "GND", pin: "GND", kind: "ground" },
    { name: "CS", pin: cs, kind: "cs" },
    { name: "SO", pin: "D12", kind: "spi", fault: "miso-low" },
    { name: "SI", pin: "D11", kind: "spi" },
    { name: "SCK", pin: "D13", kind: "spi" },
    { name: "INT", pin: int, kind: "int", fault: "int-high" },
  ];
}

const text = (x: number, y: number, words: string, attributes = "") => `<text x="${x}" y="${y}" ${attributes}>${words}</text>`;
const END_ANCHOR = 'text-anchor="end"';
const MIDDLE = 'text-anchor="middle"';

/** A wire along a path. One with a fault is a button, with room for a finger. */
function wire(kind: string, path: string, fault = "", title = "") {
  const line = `<path class="line" pathLength="100" d="${path}"/>`;
  if (fault === "") {
    return `<g class="wire ${kind}">${line}</g>`;
  }
  const button = `role="button" tabindex="0" aria-pressed="false" aria-label="${title}" data-fault="${fault}"`;
  return `<g class="wire ${kind}" ${button}><title>${title}</title><path class="hit" d="${path}"/>${line}</g>`;
}

export class Picture {
  private readonly element = byId<HTMLElement>("picture");
  private outputs: Element[] = [];
  private pins = "";
  private light: SVGElement | null = null;

  /** `inject` begins or ends a fault. */
  constructor(inject: (fault: string) => void) {
    const press = ({ target }: Event) => {
      const pressed = (target as Element).closest<HTMLElement>("[data-fault]");
      if (pressed) {
        inject(pressed.dataset.fault!);
      }
    };
    this.element.addEventListener("click", press);
    this.element.addEventListener("keydown", (event) => {
      if ((event.key === "Enter" || event.key === " ") && (event.target as HTMLElement).dataset.fault) {
        event.preventDefault();
        press(event);
      }
    });
  }

  /** Draws a board that begins. */
  begin(wiring: Wiring) {
    this.element.innerHTML = [
      ...this.bus(),
      ...this.shield(wiring),
      ...this.arduino(wiring),
      '<g id="picture-outputs"></g>',
    ].join("");
    this.pins = "";
    this.light = this.element.querySelector("#light");
  }

  private bus() {
    const far = `<rect class="resistor" x="2" y="62" width="8" height="24" rx="2"/>${text(14, 104, "120 Ω", 'class="small"')}`;
    const lines = [66, 82].map((y) => wire("can trunk", `M6 ${y}H120`));
    const flow = `<path class="flow" d="M10 74H120"/>`;
    const cable = wire("can cable", `M120 66H${LEFT}M120 82H${LEFT}`, "cable", "Bus cable of the node: pull it, or plug it in");
    const stations = STATIONS.map(
      ([name, x]) =>
        `<g class="station" data-from="${name}">${wire("can", `M${x + 28} 82V122`)}` +
        `<rect x="${x}" y="122" width="56" height="24" rx="4"/>${text(x + 28, 138, name, MIDDLE)}</g>`,
    );
    return [text(8, 50, "CAN bus"), text(8, 34, "from the autopilot", 'class="small"'), far, ...lines, flow, cable, ...stations];
  }

  private shield(wiring: Wiring) {
    const { is_wired, crystal_mhz } = wiring;
    const wires = controller(wiring).map(({ name, pin, kind, fault }, row) => {
      const y = TOP + STEP * row;
      const what = { "chip-power": "cut it", "miso-low": "short it to ground", "int-high": "short it to the supply" }[fault ?? ""];
      const title = `${name} to ${pin}: ${what}, or mend it`;
      return (
        wire(kind, `M${SHIELD} ${y}H${ARDUINO}`, fault, title) +
        text(SHIELD - 6, y + 4, name, `${END_ANCHOR} class="pin"`) +
        text(ARDUINO + 6, y + 4, pin, 'class="pin"')
      );
    });
    return [
      `<rect class="pcb shield" x="${LEFT}" y="8" width="${SHIELD - LEFT}" height="164" rx="6"/>`,
      `<rect class="terminal" x="${LEFT - 4}" y="58" width="14" height="32" rx="2"/>`,
      text(LEFT + 14, 70, "H", 'class="pin"'),
      text(LEFT + 14, 86, "L", 'class="pin"'),
      `<rect class="chip" x="${LEFT + 14}" y="98" width="76" height="28" rx="2"/>`,
      text(LEFT + 52, 116, "MCP2515", `${MIDDLE} class="pin"`),
      `<rect class="crystal" x="${LEFT + 14}" y="20" width="62" height="20" rx="9"/>`,
      text(LEFT + 45, 34, `${crystal_mhz} MHz`, `${MIDDLE} class="ink small"`),
      text(LEFT + 14, 162, is_wired ? "CAN board" : "shield, plugged on", 'class="pin"'),
      ...wires,
    ];
  }

  private arduino({ board, chip, sensor, light, button }: Wiring) {
    const parts: string[] = [];
    const part = (x: number, pin: string | null, drawing: string, name: string) => {
      if (pin !== null) {
        parts.push(text(x, 164, pin, `${MIDDLE} class="pin"`), drawing, text(x + 14, 203, name, 'class="small"'));
      }
    };
    const drop = (x: number) => `M${x} 172V186`;
    const cut = wire("plain", drop(422), "sensor-short", `Temperature sensor at ${sensor}: short it to ground, or mend it`);
    part(422, sensor, `${cut}<path class="chip" d="M412 188H432V200H412Z"/>`, "LM35");
    part(484, light, `${wire("plain", drop(484))}<circle id="light" cx="484" cy="194" r="9"/>`, "LED");
    const attributes = 'id="button" role="button" tabindex="0" aria-pressed="false" aria-label="Button"';
    part(
      540,
      button,
      `${wire("plain", drop(540))}<g ${attributes}><rect class="chip" x="528" y="184" width="24" height="22" rx="3"/><circle class="cap" cx="540" cy="195" r="7"/></g>`,
      "&#160;&#160;button",
    );
    return [
      `<rect class="pcb arduino" x="${ARDUINO}" y="8" width="${RIGHT - ARDUINO}" height="164" rx="6"/>`,
      `<rect class="crystal" x="468" y="2" width="34" height="26" rx="2"/>`,
      text(485, 48, board.replace("Arduino ", "Arduino\u00a0").slice(0, 24), `${MIDDLE} class="pin"`),
      `<rect class="chip" x="440" y="92" width="90" height="30" rx="2"/>`,
      text(485, 111, chip, `${MIDDLE} class="pin"`),
      ...parts,
    ];
  }

  show({ outputs, light, faults, load }: Snapshot) {
    const pins = outputs.map(({ pin }) => pin).join();
    if (pins !== this.pins) {
      this.pins = pins;
      const group = byId("picture-outputs");
      group.innerHTML = outputs
        .map(({ pin }, index) => {
          const y = TOP + OUTPUT_STEP * index;
          return wire("pulse", `M${RIGHT} ${y}H${END}`) + text(RIGHT - 6, y + 4, pin, `${END_ANCHOR} class="pin"`);
        })
        .join("");
      this.outputs = [...group.querySelectorAll(".wire")];
    }
    outputs.forEach(({ width_us }, index) => this.outputs[index].classList.toggle("on", width_us !== null));
    this.light?.style.setProperty("--duty", String(light));
    this.element.classList.toggle("quiet", load === 0);
    for (const button of this.element.querySelectorAll<HTMLElement>("[data-fault]")) {
      setPressed(button, faults.includes(button.dataset.fault!));
    }
  }

  /** Lights the wires that carry a frame; none for null. */
  carry(frame: FrameDetail | null) {
    const { classList } = this.element;
    const isNode = frame?.from === "node";
    const isFetched = frame !== null && (isNode || Boolean(frame.spi));
    classList.toggle("carries", frame !== null);
    classList.toggle("fetched", isFetched);
    for (const station of this.element.querySelectorAll<HTMLElement>(".station")) {
      const isOther = frame !== null && !["autopilot", "node", "tool"].includes(frame.from);
      station.classList.toggle("lit", station.dataset.from === (isOther ? "others" : frame?.from));
    }
  }
}
