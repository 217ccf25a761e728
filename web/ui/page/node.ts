// What the node says of itself, and the counters of its controller.

import { byId, make, setText } from "./dom";
import type { Snapshot } from "./types";

/** A node that was silent for so long is shown as silent. */
const SILENT_S = 3;

export class NodeView {
  show({ node, controller }: Snapshot) {
    const isSilent = !node || node.silent_s > SILENT_S;
    const health = byId("health");
    setText(health, isSilent ? "silent" : node.health);
    health.className = isSilent ? "badge" : `badge ${node.health}`;
    const silence = node ? `, last heard ${node.silent_s.toFixed(0)} s ago` : "not heard yet";
    const about = node ? `node ${node.id}: ${node.mode}, up ${node.uptime_s} s` : "";
    setText(byId("node-text"), isSilent ? about + silence : about);
    this.list(node?.conditions ?? []);
    const { mode, error_state, tec, rec, lost, worst_us } = controller;
    setText(
      byId("controller"),
      `MCP2515: ${mode} mode, error ${error_state.toLowerCase()}, TEC ${tec}, REC ${rec}. ` +
        `${lost} frames lost; frames wait for the program ${worst_us.toFixed(0)} µs at most.`,
    );
  }

  private list(conditions: [string, string][]) {
    const list = byId("conditions");
    const shown = conditions.join("|");
    if (list.dataset.shown !== shown) {
      list.dataset.shown = shown;
      list.replaceChildren(
        ...conditions.map(([text, advice]) => make("li", { textContent: `${text}: ${advice}` })),
      );
    }
  }
}
