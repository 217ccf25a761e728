// A bus: its frames on a time line and in words, the bits of the one that is chosen, the log of its
// nodes, and plots of numbers in its messages.

import { Detail } from "./detail";
import { byId, mount, setText } from "./dom";
import { Fields } from "./fields";
import { Log } from "./log";
import type { Marks } from "./marks";
import { type Lane, Timeline } from "./timeline";
import type { FrameDetail, FrameEvent } from "./types";

export class BusPanel {
  private readonly detail: Detail;
  private readonly timeline: Timeline;
  private readonly log: Log;
  private readonly fields: Fields;

  /**
   * `prefix` begins the IDs of its elements. `frame` gives the JSON of a frame, and throws if it is
   * too old; `chosen` gets the frame that is chosen.
   */
  constructor(
    private readonly prefix: string,
    lanes: Lane[],
    marks: Marks | null,
    frame: (number: number) => string,
    chosen: (detail: FrameDetail | null) => void = () => {},
    note = "",
  ) {
    mount("bus-template", byId(`${prefix}bus-place`), prefix);
    mount("log-template", byId(`${prefix}log-place`), prefix);
    this.log = new Log(prefix);
    this.fields = new Fields(prefix, marks);
    this.detail = new Detail(prefix, note);
    this.timeline = new Timeline(prefix, lanes, marks, (number) => {
      let detail: FrameDetail | null = null;
      try {
        detail = JSON.parse(frame(number));
      } catch {
        // It is too old.
      }
      this.detail.show(detail);
      this.fields.offer(detail);
      chosen(detail);
    });
    byId(`${prefix}bus-place`).addEventListener("click", () => this.detail.reveal());
  }

  clear() {
    this.timeline.clear();
    this.detail.show(null);
    this.log.clear();
    this.fields.clear();
  }

  add(frame: FrameEvent) {
    this.timeline.add(frame);
    this.log.add(frame);
    this.fields.add(frame);
  }

  chooseNewest() {
    this.timeline.chooseNewest();
  }

  /** Marks the next bit of the chosen frame. Returns its time in seconds; null after the last. */
  nextBit() {
    return this.detail.nextBit();
  }

  draw(now: number, load: string) {
    this.timeline.draw(now);
    this.log.draw();
    this.fields.draw(now);
    setText(byId(`${this.prefix}load`), load);
  }

  setLanes(lanes: Lane[]) {
    this.timeline.lanes = lanes;
  }
}
