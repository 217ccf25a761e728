// The simulated board: its picture, its sensor, its light and its button.

import { byId, onClick, setPressed, setText } from "./dom";
import { Picture } from "./picture";
import type { FrameDetail, Snapshot, Wiring } from "./types";
import type { World } from "./world";

export class BoardView {
  private readonly temperature = byId<HTMLInputElement>("temperature");
  private readonly brightness = byId<HTMLInputElement>("brightness");
  private readonly chips = byId<HTMLSelectElement>("corner");
  private readonly picture: Picture;
  /** Seed of the values that the chips have by chance. */
  private seed = 1;

  constructor(private readonly world: World) {
    const { temperature, brightness } = this;
    temperature.addEventListener("input", () => world.simulation.set_temperature(Number(temperature.value)));
    brightness.addEventListener("input", () => world.simulation.set_light(Number(brightness.value)));
    this.chips.addEventListener("change", () => (this.seed = Math.floor(Math.random() * 1e6)));
    onClick("reset", () => world.simulation.inject("reset"));
    this.picture = new Picture((fault) => world.simulation.inject(fault));
  }

  /** The corner of the chips, as `sim --corner` takes it. */
  get corner() {
    return this.chips.value === "random" ? `random:${this.seed}` : this.chips.value;
  }

  set corner(corner: string) {
    const [kind, seed] = corner.split(":");
    this.seed = Number(seed) || this.seed;
    this.chips.value = kind;
    if (this.chips.selectedIndex < 0) {
      this.chips.value = "typical";
    }
  }

  begin() {
    const wiring: Wiring = JSON.parse(this.world.simulation.wiring());
    this.temperature.value = "20";
    this.brightness.value = "0";
    setText(byId("wiring"), wiring.text);
    setText(byId("corner-text"), wiring.corner || "Typical values");
    byId("light-box").hidden = wiring.light === null;
    this.picture.begin(wiring);
    if (wiring.button !== null) {
      this.listenToButton(byId("button"));
    }
  }

  show(snapshot: Snapshot) {
    const { sensor_c, light } = snapshot;
    setText(byId("sensor"), `${sensor_c.toFixed(1)} °C`);
    this.temperature.setAttribute("aria-valuetext", `${sensor_c.toFixed(1)} °C`);
    setText(byId("light-text"), `${Math.round(light * 100)} %`);
    this.picture.show(snapshot);
  }

  /** Shows the way of the frame that is chosen. */
  carry(frame: FrameDetail | null) {
    this.picture.carry(frame);
  }

  private listenToButton(button: HTMLElement) {
    const press = (pressed: boolean) => () => {
      setPressed(button, pressed);
      this.world.simulation.press_button(pressed);
    };
    const byKey = (act: () => void) => (event: KeyboardEvent) => {
      if (event.key === " " || event.key === "Enter") {
        event.preventDefault();
        act();
      }
    };
    button.addEventListener("pointerdown", press(true));
    button.addEventListener("pointerup", press(false));
    button.addEventListener("pointerleave", press(false));
    button.addEventListener("keydown", byKey(press(true)));
    button.addEventListener("keyup", byKey(press(false)));
    button.addEventListener("blur", press(false));
  }
}
