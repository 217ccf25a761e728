// Serves a directory of static files, and prints the address.
//
//   node serve.mjs [DIRECTORY [PORT [HOST]]]    port 0, the default, is any free one; without HOST
//                                               on loopback, which other machines do not reach

import { createServer } from "node:http";
import { createReadStream, statSync } from "node:fs";
import { constants, createBrotliCompress, createGzip } from "node:zlib";
import { extname, join, normalize, resolve, sep } from "node:path";
import { pathToFileURL } from "node:url";

const TYPES = {
  ".html": "text/html; charset=utf-8",
  ".js": "text/javascript; charset=utf-8",
  ".css": "text/css; charset=utf-8",
  ".txt": "text/plain; charset=utf-8",
  ".svg": "image/svg+xml",
  ".png": "image/png",
  ".json": "application/json",
  ".webmanifest": "application/manifest+json",
  ".wasm": "application/wasm",
};

/** Files that are compressed already. */
const COMPRESSED = [".png"];
/** How fast a file of 2 MB is compressed: in 0.1 s, to a third. */
const QUALITY = 5;

/** The first encoding that a browser takes, and a stream that does it; null without one. */
function encoder(request, file) {
  const accepted = (request.headers["accept-encoding"] ?? "").split(",").map((name) => name.split(";")[0].trim());
  if (COMPRESSED.includes(extname(file))) {
    return null;
  }
  if (accepted.includes("br")) {
    return ["br", createBrotliCompress({ params: { [constants.BROTLI_PARAM_QUALITY]: QUALITY } })];
  }
  return accepted.includes("gzip") ? ["gzip", createGzip()] : null;
}

/** The path of a request; null if it is no path. */
function pathOf(request) {
  try {
    return decodeURIComponent(new URL(request.url, "http://localhost").pathname);
  } catch {
    return null;
  }
}

/** Starts a server for a directory. Returns it and its address. Throws if the port is in use. */
export async function serve(directory, port = 0, host = "127.0.0.1") {
  const root = resolve(directory);
  const server = createServer((request, response) => {
    const path = pathOf(request);
    if (path === null || path.includes("\0")) {
      response.writeHead(400).end("no path");
      return;
    }
    const file = join(root, normalize(path.endsWith("/") ? `${path}index.html` : path));
    const isFile = file.startsWith(root + sep) && statSync(file, { throwIfNoEntry: false })?.isFile();
    if (!isFile) {
      response.writeHead(404).end("not found");
      return;
    }
    const encoding = encoder(request, file);
    response.writeHead(200, {
      "Content-Type": TYPES[extname(file)] ?? "application/octet-stream",
      Vary: "Accept-Encoding",
      ...(encoding && { "Content-Encoding": encoding[0] }),
    });
    const read = createReadStream(file).on("error", () => response.destroy());
    (encoding ? read.pipe(encoding[1]) : read).pipe(response);
  });
  await new Promise((done, failed) => {
    server.once("error", failed);
    server.listen(port, host, done);
  });
  const name = host.includes(":") ? `[${host}]` : host;
  return { server, address: `http://${name}:${server.address().port}/` };
}

if (import.meta.url === pathToFileURL(process.argv[1]).href) {
  const [directory = "../target/web", port = "0", host = "127.0.0.1"] = process.argv.slice(2);
  const fail = (text) => {
    console.error(`${text} Use WEB_PORT=8000, or another number from 1024 to 65535; 0 is any free port.`);
    process.exit(1);
  };
  if (!/^\d+$/.test(port) || Number(port) > 65535) {
    fail(`WEB_PORT=${port} is no port.`);
  }
  try {
    const { address } = await serve(directory, Number(port), host);
    console.log(`The page is at ${address}   (Ctrl-C ends)`);
  } catch (error) {
    if (error.code === "EADDRNOTAVAIL" || error.code === "ENOTFOUND" || error.code === "EAI_AGAIN") {
      console.error(`WEB_HOST=${host} is no address of this machine. 0.0.0.0 is all that it has.`);
      process.exit(1);
    }
    fail(error.code === "EADDRINUSE" ? `Port ${port} is in use.` : `Port ${port}: ${error.message}.`);
  }
}
