// Plots over the last seconds: command and pulse, temperatures, bus load.

import uPlot from "uplot";
import { byId, colour } from "./dom";
import type { Snapshot } from "./types";

const SPAN_S = 12;
const HEIGHT = 120;
/** Time between two points. */
const STEP_S = 0.02;
const CENTRE_US = 1500;
const HALF_TRAVEL_US = 500;

type Series = (number | null)[];

class Plot {
  private readonly plot: uPlot;
  private readonly times: number[] = [];
  private readonly values: Series[];
  private isVisible = true;

  constructor(
    parent: HTMLElement,
    names: string[],
    colours: string[],
    range: [number, number] | null,
    stepped: boolean,
  ) {
    this.values = names.map(() => []);
    const ink = colour("dim");
    const grid = { stroke: colour("line"), width: 1 };
    const paths = stepped ? uPlot.paths.stepped!({ align: 1 }) : undefined;
    this.plot = new uPlot(
      {
        width: Math.max(parent.clientWidth, 200),
        height: HEIGHT,
        legend: { show: names.length > 1, live: false },
        cursor: { show: false },
        scales: { x: { time: false }, y: range ? { range } : {} },
        axes: [
          { stroke: ink, grid, size: 24, values: (_, ticks) => ticks.map((t) => `${t} s`) },
          { stroke: ink, grid, size: 54 },
        ],
        series: [
          {},
          ...names.map((label, index) => ({
            label,
            stroke: colour(colours[index]),
            width: 1.6,
            points: { show: false },
            paths,
          })),
        ],
      },
      [[], ...names.map(() => [])] as uPlot.AlignedData,
      parent,
    );
    new IntersectionObserver(([entry]) => (this.isVisible = entry.isIntersecting)).observe(parent);
    new ResizeObserver(() => {
      this.plot.setSize({ width: Math.max(parent.clientWidth, 200), height: HEIGHT });
    }).observe(parent);
  }

  add(time: number, ...values: Series) {
    this.times.push(time);
    values.forEach((value, index) => this.values[index].push(value));
    let old = 0;
    while (this.times[old] < time - SPAN_S) {
      old++;
    }
    if (old > 100) {
      this.times.splice(0, old);
      this.values.forEach((series) => series.splice(0, old));
    }
  }

  clear() {
    this.times.length = 0;
    this.values.forEach((series) => (series.length = 0));
  }

  draw(now: number) {
    // Off the screen nothing is drawn, which saves time for the simulation.
    if (this.isVisible) {
      this.plot.setData([this.times, ...this.values] as uPlot.AlignedData, false);
      this.plot.setScale("x", { min: Math.max(now - SPAN_S, 0), max: Math.max(now, 1) });
    }
  }
}

export class Plots {
  private next = 0;
  private readonly pulse = new Plot(
    byId("plot-pulse"),
    ["command", "pulse"],
    ["autopilot", "node"],
    [900, 2100],
    true,
  );
  private readonly temperature = new Plot(
    byId("plot-temperature"),
    ["sensor", "node"],
    ["autopilot", "node"],
    [0, 100],
    true,
  );
  private readonly load = new Plot(byId("plot-load"), ["load"], ["ok"], [0, 100], false);

  add(snapshot: Snapshot, command: number) {
    const { now } = snapshot;
    if (now < this.next) {
      return;
    }
    this.next = now + STEP_S;
    const commandUs = CENTRE_US + command * HALF_TRAVEL_US;
    this.pulse.add(now, commandUs, snapshot.outputs[0].width_us);
    this.temperature.add(now, snapshot.sensor_c, snapshot.node_c);
    this.load.add(now, snapshot.load * 100);
  }

  draw(now: number) {
    [this.pulse, this.temperature, this.load].forEach((plot) => plot.draw(now));
  }

  clear() {
    this.next = 0;
    [this.pulse, this.temperature, this.load].forEach((plot) => plot.clear());
  }
}
