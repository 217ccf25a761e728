// Marks of what faults did, as "cable 3.2 s, failsafe 4.2 s": below the faults, in the plots and on
// the time line.

import { byId, colour, setText } from "./dom";
import type { TextEvent } from "./types";

const KEPT = 200;
/** Marks in words. */
const LISTED = 6;
/** Rows of texts at the lines. */
const ROWS = 4;
const ROW_HEIGHT = 14;

export class Marks {
  private marks: TextEvent[] = [];

  clear() {
    this.marks = [];
    this.list();
  }

  add(mark: TextEvent) {
    this.marks = [...this.marks.slice(1 - KEPT), mark];
    this.list();
  }

  /** A line and its text at each mark in `area`. `x` gives the place of a time. */
  draw(context: CanvasRenderingContext2D, x: (at: number) => number, area: DOMRect) {
    context.save();
    context.fillStyle = colour("error");
    context.textAlign = "left";
    // A text that would cover the one before it is in the next row.
    let [row, free] = [0, area.left];
    for (const { at, text } of this.marks) {
      const place = Math.round(x(at));
      if (place >= area.left && place <= area.right) {
        row = place < free ? (row + 1) % ROWS : 0;
        free = place + context.measureText(text).width + 6;
        context.fillRect(place, area.top, 1, area.height);
        context.fillText(text, place + 3, area.bottom - 8 - row * ROW_HEIGHT);
      }
    }
    context.restore();
  }

  private list() {
    const words = this.marks.slice(-LISTED).map(({ at, text }) => `${text} ${at.toFixed(1)} s`);
    setText(byId("marks"), words.join(", "));
  }
}
