// Tests of the server of the page, without a browser.
//
//   node --test check/serve.mjs

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdtempSync, writeFileSync } from "node:fs";
import { request } from "node:http";
import { tmpdir } from "node:os";
import { join } from "node:path";
import test from "node:test";
import { fileURLToPath } from "node:url";
import { serve } from "../serve.mjs";

const PROGRAM = fileURLToPath(new URL("../serve.mjs", import.meta.url));
const directory = mkdtempSync(join(tmpdir(), "serve-"));
writeFileSync(join(directory, "index.html"), "the page");

/** The status and the text of an answer. `path` is sent as it is. */
function get(port, path) {
  return new Promise((done, failed) => {
    const sent = request({ host: "127.0.0.1", port, path }, (response) => {
      let text = "";
      response.on("data", (part) => (text += part));
      response.on("end", () => done([response.statusCode, text]));
    });
    sent.on("error", failed);
    sent.end();
  });
}

test("the server outlives paths that are none, and gives no file outside its directory", async () => {
  const { server } = await serve(directory);
  const { port } = server.address();
  for (const [path, status] of [
    ["/%zz", 400],
    ["/%00", 400],
    ["/missing", 404],
    ["/../../../../etc/passwd", 404],
    ["/..%2f..%2f..%2f..%2fetc%2fpasswd", 404],
  ]) {
    assert.equal((await get(port, path))[0], status, path);
  }
  assert.deepEqual(await get(port, "/"), [200, "the page"]);
  server.close();
});

test("each kind of file has its type", async () => {
  const { server, address } = await serve(directory);
  for (const [name, type] of [
    ["index.html", "text/html; charset=utf-8"],
    ["licences.txt", "text/plain; charset=utf-8"],
    ["web.wasm", "application/wasm"],
    ["app.js", "text/javascript; charset=utf-8"],
    ["node.elf", "application/octet-stream"],
  ]) {
    writeFileSync(join(directory, name), "the page");
    const response = await fetch(address + name);
    assert.equal(response.headers.get("content-type"), type, name);
  }
  server.closeAllConnections();
  server.close();
});

test("files are compressed as the browser takes them", async () => {
  const { server, address } = await serve(directory);
  writeFileSync(join(directory, "app.js"), "the page ".repeat(1000));
  for (const [accepts, encoding] of [["gzip, br", "br"], ["gzip", "gzip"], ["identity", null]]) {
    const response = await fetch(`${address}app.js`, { headers: { "Accept-Encoding": accepts } });
    assert.equal(response.headers.get("content-encoding"), encoding);
    assert.equal(await response.text(), "the page ".repeat(1000));
  }
  server.closeAllConnections();
  server.close();
});

test("an address that the machine has not is answered with what to do", () => {
  const done = spawnSync(process.execPath, [PROGRAM, directory, "0", "192.0.2.1"], { encoding: "utf8" });
  assert.equal(done.status, 1, done.stdout);
  assert.match(done.stderr, /WEB_HOST=192\.0\.2\.1 is no address of this machine\. 0\.0\.0\.0/);
});

test("a wrong port and one in use are answered with what to do", async () => {
  const { server } = await serve(directory);
  for (const [port, text] of [
    [String(server.address().port), "is in use"],
    ["70000", "is no port"],
    ["-1", "is no port"],
    ["eight", "is no port"],
  ]) {
    const done = spawnSync(process.execPath, [PROGRAM, directory, port], { encoding: "utf8" });
    assert.equal(done.status, 1, done.stdout);
    assert.match(done.stderr, new RegExp(`${text}\\. Use WEB_PORT=8000`));
    assert.ok(!done.stderr.includes("at "), done.stderr);
  }
  server.close();
});
