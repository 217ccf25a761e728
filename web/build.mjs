// Bundles the page into a directory of static files that work from any server and from file:, and
// the programs of the cross-check.
//
//   node build.mjs TARGET    TARGET is cargo's target directory; writes TARGET/web and
//                            TARGET/web-build. scripts/web makes what it needs.

import { build } from "esbuild";
import { copyFileSync, mkdirSync, readFileSync, readdirSync, statSync, writeFileSync } from "node:fs";
import { join, resolve } from "node:path";

/** The page, in bytes. */
const LIMIT = 3_000_000;
/** Packages of npm that the page has. */
const LINKED = ["avr8js", "uplot"];

const target = resolve(process.argv[2] ?? "../target");
const work = join(target, "web-build");
const out = join(target, "web");
const common = {
  bundle: true,
  logLevel: "warning",
  target: "es2022",
  // For Node.js, too: the other form of avr8js calls functions through getters.
  mainFields: ["module", "main"],
  alias: { pkg: join(work, "pkg"), binary: join(work, "pkg"), programs: join(work, "programs") },
  // wasm-bindgen's default is to fetch a file: the page has the bytes.
  define: { "import.meta.url": "undefined" },
};

mkdirSync(out, { recursive: true });
await build({
  ...common,
  entryPoints: { app: "ui/page/main.ts" },
  outdir: out,
  format: "iife",
  minify: true,
  loader: { ".wasm": "binary", ".elf": "binary" },
});
copyFileSync("ui/page/index.html", join(out, "index.html"));
const licences = LINKED.map((name) => {
  const directory = `node_modules/${name}`;
  const file = readdirSync(directory).find((entry) => /^licen[sc]e/i.test(entry));
  return `${name}\n\n${readFileSync(join(directory, file), "utf8").trim()}\n`;
});
writeFileSync(join(out, "licences.txt"), licences.join(`\n${"-".repeat(80)}\n\n`));
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
