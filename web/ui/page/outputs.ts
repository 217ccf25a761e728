// The outputs as servos whose arms follow the measured pulse, with a slider for each command.

import { make, setText } from "./dom";
import type { Output } from "./types";

/** Angle of an arm for a pulse: 90 degrees for 1000 us, as usual servos. */
const DEGREES_PER_US = 90 / 1000;
const CENTRE_US = 1500;

const SERVO = `
  <svg viewBox="0 0 120 96" aria-hidden="true">
    <path class="tick" d="M22 22 L28 28 M60 8 L60 16 M98 22 L92 28" fill="none" />
    <rect class="case" x="36" y="48" width="48" height="40" rx="5" />
    <g class="arm"><path class="horn" d="M54 60 L57 14 Q60 9 63 14 L66 60 Z" /></g>
    <circle class="hub" cx="60" cy="60" r="7" />
  </svg>`;

class Servo {
  readonly element = make("div", { className: "output", innerHTML: SERVO });
  private readonly arm = this.element.querySelector<SVGElement>(".arm")!;
  private readonly width = make("strong");
  private readonly slider = make("input", {
    type: "range",
    min: "-1",
    max: "1",
    step: "0.01",
    value: "0",
  });

  constructor(index: number, pin: string, hold: (actuator: number, deflection: number) => void) {
    const label = make("label", {}, `Command ${index + 1}`, this.slider);
    this.element.append(make("div", {}, `${pin} `, this.width), label);
    this.slider.addEventListener("input", () => hold(index + 1, Number(this.slider.value)));
  }

  show(output: Output) {
    const width = output.width_us;
    setText(this.width, width === null ? "no pulses" : `${width.toFixed(1)} µs`);
    this.element.classList.toggle("off", width === null);
    if (width !== null) {
      const angle = (width - CENTRE_US) * DEGREES_PER_US;
      this.arm.setAttribute("transform", `rotate(${angle.toFixed(2)} 60 60)`);
    }
  }
}

/** The servos of a board, drawn anew when the number of outputs changes. */
export class Outputs {
  private servos: Servo[] = [];

  constructor(
    private readonly parent: HTMLElement,
    private readonly hold: (actuator: number, deflection: number) => void,
  ) {}

  show(outputs: Output[]) {
    // Outputs that give no pulses are not drawn, except the first.
    const used = outputs.findLastIndex((output) => output.width_us !== null);
    const shown = outputs.slice(0, Math.max(used + 1, 1));
    if (shown.length !== this.servos.length) {
      this.servos = shown.map((output, index) => new Servo(index, output.pin, this.hold));
      this.parent.replaceChildren(...this.servos.map((servo) => servo.element));
      this.parent.classList.toggle("one", shown.length === 1);
    }
    shown.forEach((output, index) => this.servos[index].show(output));
  }
}
