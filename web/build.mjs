// Bundles the page into a directory of static files that work from any server and from file:, and
// the programs of the cross-check.
//
//   node build.mjs TARGET    TARGET is cargo's target directory; writes TARGET/web and
//                            TARGET/web-build. scripts/web makes what it needs. REPOSITORY is the
//                            address that the page links to; by default that of the workflow.

import { createHash } from "node:crypto";
import { build } from "esbuild";
import { copyFileSync, mkdirSync, readFileSync, readdirSync, rmSync, statSync, writeFileSync } from "node:fs";
import { join, resolve } from "node:path";
import { documentPage } from "./documents.mjs";

/** The page, in bytes. */
const LIMIT = 3_000_000;
/** Packages of npm that the page has. */
const LINKED = ["uplot"];

const target = resolve(process.argv[2] ?? "../target");
const work = join(target, "web-build");
const out = join(target, "web");
const common = {
  bundle: true,
  logLevel: "warning",
  target: "es2022",
  alias: {
    pkg: join(work, "pkg"),
    binary: join(work, "pkg"),
    programs: join(work, "programs"),
    "parameters.json": join(work, "parameters.json"),
    "boards.json": join(work, "boards.json"),
  },
  // wasm-bindgen's default is to fetch a file: the page has the bytes.
  define: { "import.meta.url": "undefined" },
};

/** Unit and meaning of each parameter in the table of docs/parameters.md, as text. */
function documented() {
  const plain = (cell) => cell.replace(/\[([^\]]*)\]\([^)]*\)/g, "$1").replaceAll("`", "").trim();
  const rows = {};
  for (const line of readFileSync("../docs/parameters.md", "utf8").split("\n")) {
    const [, , name, unit, , , meaning] = line.split("|");
    const known = /^ `(\w+)`/.exec(name ?? "");
    if (known && meaning) {
      rows[known[1]] = { unit: plain(unit), meaning: plain(meaning) };
    }
  }
  return rows;
}

/** The page with links to the repository, if its address is known, instead of the page's copies. */
function withAddress(html) {
  const { GITHUB_SERVER_URL, GITHUB_REPOSITORY } = process.env;
  const workflow = GITHUB_REPOSITORY && `${GITHUB_SERVER_URL}/${GITHUB_REPOSITORY}`;
  const address = process.env.REPOSITORY ?? workflow;
  if (!address) {
    return html;
  }
  return html
    .replace('<a href="README.html">README', `<a href="${address}">Repository`)
    .replace('href="docs/README.html', `href="${address}/blob/HEAD/docs/README.md`);
}

/** Writes the documents as pages, with their drawings; screenshots are too large. */
function writeDocuments() {
  rmSync(join(out, "docs"), { recursive: true, force: true });
  mkdirSync(join(out, "docs/img"), { recursive: true });
  const pages = readdirSync("../docs").filter((name) => name.endsWith(".md")).map((name) => `docs/${name}`);
  const drawings = readdirSync("../docs/img").filter((name) => name.endsWith(".svg"));
  drawings.forEach((name) => copyFileSync(join("../docs/img", name), join(out, "docs/img", name)));
  const names = ["README.md", ...pages];
  const pageOf = (name) => join(out, name.replace(/md$/, "html"));
  // A link asks whether its page is there.
  names.forEach((name) => writeFileSync(pageOf(name), ""));
  for (const name of names) {
    writeFileSync(pageOf(name), documentPage(name, readFileSync(join("..", name), "utf8"), out));
  }
}

/** Writes the service worker, which has the names of the files, and a digest of them. */
function keepOffline() {
  const files = readdirSync(out, { recursive: true }).filter((name) => statSync(join(out, name)).isFile());
  const kept = files.filter((name) => name !== "worker.js").sort();
  const digest = createHash("sha256");
  kept.forEach((name) => digest.update(name).update(readFileSync(join(out, name))));
  const names = JSON.stringify(["./", ...kept.map((name) => name.replaceAll("\\", "/"))]);
  const worker = readFileSync("ui/page/worker.js", "utf8");
  const version = digest.digest("hex").slice(0, 16);
  writeFileSync(join(out, "worker.js"), worker.replace("VERSION", version).replace("FILES", names));
}

mkdirSync(out, { recursive: true });
writeFileSync(join(work, "parameters.json"), JSON.stringify(documented()));
await build({
  ...common,
  entryPoints: { app: "ui/page/main.ts" },
  outdir: out,
  format: "iife",
  minify: true,
  loader: { ".wasm": "binary", ".elf": "binary", ".hex": "binary" },
});
writeFileSync(join(out, "index.html"), withAddress(readFileSync("ui/page/index.html", "utf8")));
writeDocuments();
const own = [
  readFileSync("../README.md", "utf8").split("## Licences")[1],
  ...["../LICENSE-MIT", "../LICENSE-APACHE", "../sim/LICENSE"].map((file) => readFileSync(file, "utf8")),
];
const licences = LINKED.map((name) => {
  const directory = `node_modules/${name}`;
  const file = readdirSync(directory).find((entry) => /^licen[sc]e/i.test(entry));
  return `${name}\n\n${readFileSync(join(directory, file), "utf8").trim()}\n`;
});
writeFileSync(join(out, "licences.txt"), [...own, ...licences].join(`\n${"-".repeat(80)}\n\n`));
for (const name of ["manifest.webmanifest", "icon.svg"]) {
  copyFileSync(join("ui/page", name), join(out, name));
}
keepOffline();
await build({
  ...common,
  entryPoints: { run: "check/run.ts" },
  outdir: work,
  format: "esm",
  platform: "node",
  outExtension: { ".js": ".mjs" },
});
await build({
  ...common,
  entryPoints: { browser: "check/browser.ts" },
  outdir: work,
  format: "iife",
});

const bytes = readdirSync(out).reduce((sum, name) => sum + statSync(join(out, name)).size, 0);
if (bytes > LIMIT) {
  throw new Error(`the page has ${bytes} bytes, more than ${LIMIT}`);
}
console.log(`${out}: ${bytes.toLocaleString("en")} bytes of at most ${LIMIT.toLocaleString("en")}`);
