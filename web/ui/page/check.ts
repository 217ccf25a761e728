// The card "Check" of the real bus: what web/src/bus/check.rs asks and finds.

import type { RealBus } from "pkg/web.js";
import { byId, download, make, setText } from "./dom";
import type { BusCheck } from "./types";

const ABOUT =
  "Restarts the chosen node, changes parameters and puts them back, and reports what differs from the simulator: two minutes. It asks before it moves an output.";
const HEADINGS: Record<string, string> = { passed: "OK", FAILED: "FAILED", skipped: "skipped" };

export class CheckCard {
  private readonly begin = make("button", { type: "button", textContent: "Check the node" });
  private readonly stop = make("button", { type: "button", textContent: "Stop the check" });
  private readonly save = make("button", { type: "button", textContent: "Report" });
  private readonly question = make("p", { role: "alert" });
  private readonly answers = make("div", { className: "row" });
  private readonly lines = make("ul", { id: "can-check-lines" });
  private readonly summary = make("p", { id: "can-check-summary", role: "status", textContent: ABOUT });
  private left = "";

  constructor(
    private readonly bus: RealBus,
    private readonly now: () => number,
    private readonly chosen: () => number | null,
  ) {
    for (const answer of ["yes", "no", "skip"]) {
      const button = make("button", { type: "button", textContent: answer });
      button.addEventListener("click", () => this.bus.answer_check(answer));
      this.answers.append(button);
    }
    this.begin.addEventListener("click", () => {
      const node = this.chosen();
      if (node !== null) {
        this.lines.replaceChildren();
        this.bus.begin_check(node, localStorage.getItem(`check-${node}`) ?? "", this.now());
      }
    });
    this.stop.addEventListener("click", () => this.bus.stop_check());
    this.save.addEventListener("click", () => download("report.md", this.bus.check_report()));
    const buttons = make("div", { className: "row" }, this.begin, this.stop, this.save);
    byId("can-check").append(buttons, this.summary, this.question, this.answers, this.lines);
  }

  show(check: BusCheck | null, isUsable: boolean) {
    this.begin.disabled = !isUsable || (check?.runs ?? false);
    this.stop.disabled = !check?.runs;
    this.save.disabled = !check || check.runs;
    const isNew = this.question.hidden && check?.question;
    this.answers.hidden = this.question.hidden = !check?.question;
    if (isNew) {
      this.answers.scrollIntoView({ block: "nearest" });
    }
    if (!check) {
      return;
    }
    const seconds = check.seconds === null ? "" : ` (${check.seconds} s)`;
    setText(this.question, `${check.question ?? ""}${seconds}`);
    setText(this.summary, check.runs ? `Checking node ${check.node}.` : check.summary);
    for (const { text, verdict } of check.lines.slice(this.lines.childElementCount)) {
      const line = make("li", { textContent: verdict === null ? text : `${HEADINGS[verdict]}: ${text}` });
      line.classList.toggle("wrong", verdict === "FAILED");
      this.lines.append(line);
    }
    if (check.left !== this.left) {
      this.left = check.left;
      localStorage.setItem(`check-${check.node}`, check.left);
    }
  }
}
