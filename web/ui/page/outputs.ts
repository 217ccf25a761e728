// The outputs: servos whose arms follow the measured pulse, and motors whose propellers do; and a
// slider for the command of each.

import { make, setText } from "./dom";
import type { Output } from "./types";

/** Angle of an arm for a pulse: 90 degrees for 1000 us, as usual servos. */
const DEGREES_PER_US = 90 / 1000;
const CENTRE_US = 1500;
/** Pulse of a motor that stands, and its range. */
const STOP_US = 1000;
const RANGE_US = 1000;
/** OneShot125 has an eighth of the widths, up to 250 us. */
const ONESHOT = 8;
const ONESHOT_MAX_US = 300;
/** Degrees in a picture at full power. */
const FULL_SPEED = 50;

const SERVO = `
  <svg viewBox="0 0 120 96" aria-hidden="true">
    <path class="tick" d="M22 22 L28 28 M60 8 L60 16 M98 22 L92 28" fill="none" />
    <rect class="case" x="36" y="48" width="48" height="40" rx="5" />
    <g class="arm"><path class="horn" d="M54 60 L57 14 Q60 9 63 14 L66 60 Z" /></g>
    <circle class="hub" cx="60" cy="60" r="7" />
  </svg>`;
const MOTOR = `
  <svg viewBox="0 0 120 96" aria-hidden="true">
    <circle class="case" cx="60" cy="48" r="18" />
    <g class="propeller"><path class="horn" d="M60 48 Q84 32 104 46 Q84 56 60 48 Q36 64 16 50 Q36 40 60 48 Z" /></g>
    <circle class="hub" cx="60" cy="48" r="6" />
  </svg>`;

/** Moves an actuator, 1 to 255, or a motor. */
export type Hold = (output: number, motor: number | null, command: number) => void;

class Actuator {
  readonly element: HTMLElement;
  /** The slider with its label. */
  readonly control: HTMLElement;
  private readonly moving: SVGElement;
  private readonly width = make("strong");
  private readonly slider: HTMLInputElement;
  private turned = 0;

  constructor(index: number, { pin, motor }: Output, hold: Hold) {
    const [picture, name, min] = motor === null ? [SERVO, "Command", "-1"] : [MOTOR, "Power", "0"];
    this.element = make("div", { className: "output", innerHTML: picture });
    this.moving = this.element.querySelector<SVGElement>(".arm, .propeller")!;
    this.slider = make("input", { type: "range", min, max: "1", step: "0.01", value: "0" });
    this.control = make("label", { className: "command" }, `${name} ${index + 1} `, this.slider);
    this.element.append(make("div", {}, `${pin} `, this.width));
    this.slider.addEventListener("input", () => hold(index + 1, motor, Number(this.slider.value)));
  }

  show({ width_us: width, motor, command }: Output) {
    setText(this.width, width === null ? "no pulses" : `${width.toFixed(1)} µs`);
    this.element.classList.toggle("off", width === null);
    // The command in force, except while the user moves it.
    if (!this.slider.matches(":active, :focus-visible")) {
      this.slider.value = String(command);
    }
    this.slider.setAttribute("aria-valuetext", `${Math.round(Number(this.slider.value) * 100)} %`);
    if (width !== null) {
      const degrees = motor === null ? (width - CENTRE_US) * DEGREES_PER_US : this.turn(width);
      const centre = motor === null ? "60 60" : "60 48";
      this.moving.setAttribute("transform", `rotate(${degrees.toFixed(2)} ${centre})`);
    }
  }

  /** Angle of the propeller in the next picture. */
  private turn(width: number) {
    const normal = width < ONESHOT_MAX_US ? width * ONESHOT : width;
    this.turned = (this.turned + (Math.max(normal - STOP_US, 0) / RANGE_US) * FULL_SPEED) % 360;
    return this.turned;
  }
}

/** The actuators of a board, drawn anew when an output begins or ends, or gets another type. */
export class Outputs {
  private actuators: Actuator[] = [];
  private drawn = "";

  constructor(
    private readonly parent: HTMLElement,
    private readonly controls: HTMLElement,
    private readonly hold: Hold,
  ) {}

  show(outputs: Output[]) {
    // Outputs that give no pulses are not drawn, except the first.
    const used = outputs.findLastIndex((output) => output.width_us !== null);
    const shown = outputs.slice(0, Math.max(used + 1, 1));
    const drawn = shown.map(({ pin, motor }) => `${pin} ${motor}`).join();
    if (drawn !== this.drawn) {
      this.drawn = drawn;
      this.actuators = shown.map((output, index) => new Actuator(index, output, this.hold));
      this.parent.replaceChildren(...this.actuators.map((actuator) => actuator.element));
      this.controls.replaceChildren(...this.actuators.map((actuator) => actuator.control));
      this.parent.classList.toggle("one", shown.length === 1);
    }
    shown.forEach((output, index) => this.actuators[index].show(output));
  }
}
