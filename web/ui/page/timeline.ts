// The bus as a timeline of frames, a lane for each sender, and the list of the latest transfers.

import { byId, colour, make, prepare, setPressed } from "./dom";
import type { Marks } from "./marks";
import type { FrameEvent } from "./types";

/** Frames that are kept for the timeline. page.rs keeps the details of 4096. */
const KEPT = 4000;
const ROWS = 7;
const LANE_HEIGHT = 24;
const LEFT = 76;
const AXIS = 20;
/** Room for a time, and a gap. */
const TICK_WIDTH = 110;

/** A sender, and its colour in app.css. The last lane is for all that have none. */
export interface Lane {
  name: string;
  colour: string;
}

export class Timeline {
  private frames: FrameEvent[] = [];
  private selected: number | null = null;
  private end = 0;
  private follows = true;
  private rows: { row: HTMLLIElement; button: HTMLButtonElement; cells: HTMLElement[] }[] = [];
  private readonly canvas: HTMLCanvasElement;
  private readonly span: HTMLSelectElement;
  private readonly filter: HTMLSelectElement;
  private readonly followButton: HTMLElement;

  /** `prefix` begins the IDs of its elements. */
  constructor(
    private readonly prefix: string,
    public lanes: Lane[],
    private readonly marks: Marks | null,
    private readonly select: (number: number) => void,
  ) {
    this.canvas = byId<HTMLCanvasElement>(`${prefix}timeline`);
    this.span = byId<HTMLSelectElement>(`${prefix}window`);
    this.filter = byId<HTMLSelectElement>(`${prefix}filter`);
    this.followButton = byId(`${prefix}follow`);
    this.canvas.addEventListener("click", (event) => this.click(event.offsetX, event.offsetY));
    this.canvas.addEventListener("keydown", (event) => {
      const step = event.key === "ArrowRight" ? 1 : event.key === "ArrowLeft" ? -1 : 0;
      if (step) {
        event.preventDefault();
        this.step(step);
      }
    });
    this.followButton.addEventListener("click", () => this.follow(!this.follows));
    byId(`${prefix}previous`).addEventListener("click", () => this.step(-1));
    byId(`${prefix}next`).addEventListener("click", () => this.step(1));
    this.makeRows();
  }

  clear() {
    this.frames = [];
    this.selected = null;
    this.follow(true);
  }

  add(frame: FrameEvent) {
    this.frames.push(frame);
    if (this.frames.length > 2 * KEPT) {
      this.frames.splice(0, KEPT);
    }
  }

  /** Index of the lane of a sender. */
  private lane(from: string) {
    const at = this.lanes.findIndex(({ name }) => name === from);
    return at < 0 ? this.lanes.length - 1 : at;
  }

  draw(now: number) {
    if (this.follows) {
      this.end = now;
    }
    this.drawLanes();
    this.drawRows();
  }

  private follow(follows: boolean) {
    this.follows = follows;
    setPressed(this.followButton, follows);
  }

  chooseNewest() {
    this.choose(this.frames.at(-1));
  }

  private choose(frame: FrameEvent | undefined) {
    if (!frame) {
      return;
    }
    this.selected = frame.number;
    this.follow(false);
    const span = Number(this.span.value);
    if (frame.end > this.end || frame.start < this.end - span) {
      this.end = frame.end + span / 4;
    }
    this.select(frame.number);
  }

  /** Chooses the next frame or the one before; without a choice, the newest. */
  private step(step: number) {
    const at = this.frames.findIndex((frame) => frame.number === this.selected);
    this.choose(at < 0 ? this.frames.at(-1) : this.frames[at + step]);
  }

  private click(x: number, y: number) {
    const span = Number(this.span.value);
    const scale = (this.canvas.clientWidth - LEFT) / span;
    const time = this.end - span + (x - LEFT) / scale;
    const wanted = Math.floor(y / LANE_HEIGHT);
    const distance = (frame: FrameEvent) =>
      Math.max(frame.start - time, time - frame.end, 0) * scale + (this.lane(frame.from) === wanted ? 0 : 8);
    const visible = this.frames.filter((frame) => frame.end > this.end - span);
    const [nearest] = visible.sort((a, b) => distance(a) - distance(b));
    if (nearest && distance(nearest) < 20) {
      this.choose(nearest);
    }
  }

  private drawLanes() {
    const width = this.canvas.clientWidth;
    const height = this.lanes.length * LANE_HEIGHT + AXIS;
    const context = prepare(this.canvas, width, height);
    this.canvas.style.height = `${height}px`;
    const span = Number(this.span.value);
    const start = this.end - span;
    const scale = (width - LEFT) / span;
    context.font = "12px system-ui, sans-serif";
    context.textBaseline = "middle";
    const [ink, dim, line] = ["ink", "dim", "line"].map(colour);
    this.lanes.forEach(({ name }, index) => {
      context.fillStyle = dim;
      context.fillText(name, 6, index * LANE_HEIGHT + LANE_HEIGHT / 2);
      context.fillStyle = line;
      context.fillRect(LEFT, (index + 1) * LANE_HEIGHT - 1, width, 1);
    });
    // As many times as there is room for.
    const ticks = Math.max(1, Math.min(5, Math.floor((width - LEFT) / TICK_WIDTH)));
    for (let tick = 0; tick <= ticks; tick++) {
      const x = LEFT + ((width - LEFT) * tick) / ticks;
      context.fillStyle = line;
      context.fillRect(x, 0, 1, height - AXIS + 4);
      context.fillStyle = dim;
      context.textAlign = tick === ticks ? "right" : tick === 0 ? "left" : "center";
      const ms = (start + (span * tick) / ticks) * 1000;
      context.fillText(`${ms.toFixed(span < 0.05 ? 1 : 0)} ms`, x, height - AXIS / 2);
    }
    context.textAlign = "left";
    const colours = this.lanes.map((lane) => colour(lane.colour));
    const error = colour("error");
    for (let at = this.frames.length - 1; at >= 0 && this.frames[at].end > start; at--) {
      const frame = this.frames[at];
      const index = this.lane(frame.from);
      const x = LEFT + Math.max((frame.start - start) * scale, 0);
      const right = LEFT + (frame.end - start) * scale;
      const y = index * LANE_HEIGHT + 5;
      context.fillStyle = frame.frame === "error" ? error : colours[index];
      context.fillRect(x, y, Math.max(right - x, 1), LANE_HEIGHT - 11);
      if (frame.number === this.selected) {
        context.strokeStyle = ink;
        context.lineWidth = 2;
        context.strokeRect(x - 2, y - 2, Math.max(right - x, 1) + 4, LANE_HEIGHT - 7);
      }
    }
    const area = new DOMRect(LEFT, 0, width - LEFT, height - AXIS);
    this.marks?.draw(context, (at) => LEFT + (at - start) * scale, area);
  }

  private makeRows() {
    this.rows = Array.from({ length: ROWS }, () => {
      const cells = [make("span"), make("span"), make("span")];
      const button = make("button", { type: "button" }, ...cells);
      button.addEventListener("click", () => {
        const number = Number(button.dataset.number);
        this.choose(this.frames.find((frame) => frame.number === number));
      });
      return { row: make("li", {}, button), button, cells };
    });
    byId(`${this.prefix}traffic`).replaceChildren(...this.rows.map(({ row }) => row));
  }

  private drawRows() {
    const hidden = this.filter.value;
    const shown: FrameEvent[] = [];
    for (let at = this.frames.length - 1; at >= 0 && shown.length < ROWS; at--) {
      const frame = this.frames[at];
      const isListed = frame.frame !== "part" || frame.number === this.selected;
      if (frame.end <= this.end && isListed && (!hidden || !frame.name?.includes(hidden))) {
        shown.unshift(frame);
      }
    }
    this.rows.forEach(({ row, button, cells }, index) => {
      const frame = shown[index];
      row.hidden = !frame;
      if (frame && button.dataset.number !== String(frame.number)) {
        button.dataset.number = String(frame.number);
        cells[0].textContent = frame.start.toFixed(4);
        cells[1].textContent = frame.from;
        cells[1].className = `from-${frame.from.split(" ")[0]}`;
        cells[2].textContent = frame.text;
        button.title = frame.text;
      }
      button.setAttribute("aria-current", String(frame?.number === this.selected));
    });
  }
}
