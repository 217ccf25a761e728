// The service worker: the page works offline after the first visit. build.mjs puts the names of the
// files and a digest of them into it. A new version waits until the user
// wants it.

const CACHE = "page VERSION";

self.addEventListener("install", (event) => {
  // Past the browser's own cache, which may have files of another version.
  const requests = FILES.map((name) => new Request(name, { cache: "reload" }));
  event.waitUntil(caches.open(CACHE).then((cache) => cache.addAll(requests)));
});

self.addEventListener("activate", (event) => {
  const remove = (names) => Promise.all(names.filter((name) => name !== CACHE).map((name) => caches.delete(name)));
  event.waitUntil(caches.keys().then(remove).then(() => self.clients.claim()));
});

self.addEventListener("message", () => self.skipWaiting());

self.addEventListener("fetch", (event) => {
  const isKept = caches.open(CACHE).then((cache) => cache.match(event.request, { ignoreSearch: true }));
  event.respondWith(isKept.then((kept) => kept ?? fetch(event.request)));
});
