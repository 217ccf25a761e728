// The simulated board's sensor, light, button and supply.

import { byId, onClick, setPressed, setText } from "./dom";
import type { Snapshot } from "./types";
import type { World } from "./world";

export class BoardView {
  private readonly temperature = byId<HTMLInputElement>("temperature");
  private readonly brightness = byId<HTMLInputElement>("brightness");

  constructor(private readonly world: World) {
    const { temperature, brightness } = this;
    temperature.addEventListener("input", () => world.simulation.set_temperature(Number(temperature.value)));
    brightness.addEventListener("input", () => world.simulation.set_light(Number(brightness.value)));
    onClick("reset", () => world.simulation.inject("reset"));
    this.listenToButton();
  }

  begin(snapshot: Snapshot) {
    this.temperature.value = "20";
    this.brightness.value = "0";
    setText(byId("wiring"), snapshot.board);
    byId("button").hidden = !snapshot.has_button;
    byId("light-box").hidden = !snapshot.has_light;
  }

  show({ sensor_c, light }: Snapshot) {
    setText(byId("sensor"), `${sensor_c.toFixed(1)} °C`);
    this.temperature.setAttribute("aria-valuetext", `${sensor_c.toFixed(1)} °C`);
    byId("light").style.setProperty("--duty", String(light));
    setText(byId("light-text"), `${Math.round(light * 100)} %`);
  }

  private listenToButton() {
    const button = byId("button");
    const press = (pressed: boolean) => () => {
      setPressed(button, pressed);
      this.world.simulation.press_button(pressed);
    };
    const byKey = (act: () => void) => (event: KeyboardEvent) => {
      if (event.key === " " || event.key === "Enter") {
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
