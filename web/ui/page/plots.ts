// Plots over the last seconds: command and pulse, temperatures, bus load.

import uPlot from "uplot";
import { byId, colour } from "./dom";
import type { Marks } from "./marks";
import type { Snapshot } from "./types";

const SPAN_S = 12;
const HEIGHT = 120;
/** Time between two points. */
const STEP_S = 0.02;
const CENTRE_US = 1500;
const HALF_TRAVEL_US = 500;

type Series = (number | null)[];

function drawMarks({ ctx, bbox, valToPos }: uPlot, marks: Marks | null) {
  const area = new DOMRect(bbox.left, bbox.top, bbox.width, bbox.height);
  marks?.draw(ctx, (at) => valToPos(at, "x", true), area);
}

export class Plot {
  private readonly plot: uPlot;
  private readonly times: number[] = [];
  private readonly values: Series[];
  private isVisible = true;

  /** Without a range, it is that of the values. */
  constructor(
    parent: HTMLElement,
    names: string[],
    colours: string[],
    range: [number, number] | null,
    stepped: boolean,
    marks: Marks | null,
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
        hooks: { draw: [(plot) => drawMarks(plot, marks)] },
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
  private readonly pulse: Plot;
  private readonly temperature: Plot;
  private readonly load: Plot;

  constructor(marks: Marks) {
    const colours = ["autopilot", "node"];
    this.pulse = new Plot(byId("plot-pulse"), ["command", "pulse"], colours, [900, 2100], true, marks);
    this.temperature = new Plot(byId("plot-temperature"), ["sensor", "node"], colours, [0, 100], true, marks);
    this.load = new Plot(byId("plot-load"), ["load"], ["ok"], [0, 100], false, marks);
  }

  add(snapshot: Snapshot) {
    const { now } = snapshot;
    if (now < this.next) {
      return;
    }
    this.next = now + STEP_S;
    const [{ motor, command, width_us }] = snapshot.outputs;
    const deflection = motor === null ? command : 2 * command - 1;
    this.pulse.add(now, CENTRE_US + deflection * HALF_TRAVEL_US, width_us);
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
