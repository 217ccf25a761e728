// Registers the service worker, worker.js, and says when it has a new version of the page.

import { byId, make, onClick } from "./dom";

/** Real time after which the files are kept: the simulation begins first. */
const LATER_MS = 5000;

function offer(worker: ServiceWorker) {
  byId("new-version").hidden = false;
  onClick("use-version", () => {
    navigator.serviceWorker.addEventListener("controllerchange", () => location.reload());
    worker.postMessage("use");
  });
}

async function register() {
  // None if the user or a test forbids it.
  const registration: ServiceWorkerRegistration | undefined = await navigator.serviceWorker.register("worker.js");
  if (registration?.waiting) {
    offer(registration.waiting);
  }
  registration?.addEventListener("updatefound", () => {
    const worker = registration.installing;
    worker?.addEventListener("statechange", () => {
      if (worker.state === "installed" && navigator.serviceWorker.controller) {
        offer(worker);
      }
    });
  });
}

/** Makes the page an app, which is kept for a time without a network, if it comes from a server. */
export function keepOffline() {
  if ("serviceWorker" in navigator && location.protocol !== "file:") {
    document.head.append(make("link", { rel: "manifest", href: "manifest.webmanifest" }));
    // A browser that forbids it has the page from the server.
    setTimeout(() => void register().catch(() => {}), LATER_MS);
  }
}
