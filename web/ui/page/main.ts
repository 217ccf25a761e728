// The page: its views, one of which is on the screen.

import "./app.css";
import "uplot/dist/uPlot.min.css";
import wasm from "binary/web_bg.wasm";
import { initSync } from "pkg/web.js";
import { keepOffline } from "./offline";
import { RealBoard } from "./real-board";
import { RealBusView } from "./real-bus";
import { SimulatedPort } from "./simulated-port";
import { SimulatedView } from "./simulated";
import { Tour } from "./tour";
import { Views } from "./views";

initSync({ module: wasm.slice() });

const simulated = new SimulatedView();
const realBoard = new RealBoard();
const realBus = new RealBusView(new SimulatedPort(() => simulated.simulation));
const views = new Views();
new Tour(simulated);

/** Files that are dropped go to the view on the screen. */
function listenToFiles() {
  const { classList } = document.body;
  document.addEventListener("dragover", (event) => {
    event.preventDefault();
    classList.add("drop");
  });
  document.addEventListener("dragleave", () => classList.remove("drop"));
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    classList.remove("drop");
    const file = event.dataTransfer?.files[0];
    if (views.shown === "simulated") {
      void simulated.open(file);
    } else if (views.shown === "board") {
      void realBoard.open(file);
    } else {
      realBus.refuse(file);
    }
  });
}

function draw(time: number) {
  realBoard.draw(time);
  realBus.draw(time);
  // Off the screen, the time of the simulated board stands still.
  if (views.shown === "simulated" || realBus.isSimulated) {
    simulated.draw(time);
  }
  requestAnimationFrame(draw);
}

listenToFiles();
keepOffline();
views.onChange(() => simulated.synchronise());
views.follow();
requestAnimationFrame(draw);
