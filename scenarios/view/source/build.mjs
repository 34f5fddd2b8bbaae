// Builds ../page/code.json and ../page/view.css, and collects the licences of the bundled libraries.
// `node build.mjs [FOLDER]` writes elsewhere. The same versions give the same code.
import { build } from "esbuild";
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { deflateSync } from "node:zlib";

const here = dirname(fileURLToPath(import.meta.url));
const out = process.argv[2] ?? join(here, "..", "page");
const libraries = ["three", "uplot"];

const licences = libraries.map((name) => {
  const folder = join(here, "node_modules", name);
  const { version } = JSON.parse(readFileSync(join(folder, "package.json"), "utf8"));
  return `${name} ${version}\n\n${readFileSync(join(folder, "LICENSE"), "utf8").trim()}\n`;
});
const notice = `Contains the following libraries, each under its own licence.\n\n${licences.join(`\n${"-".repeat(78)}\n\n`)}`;

mkdirSync(out, { recursive: true });
writeFileSync(join(out, "LICENSES.txt"), notice);
const { outputFiles } = await build({
  absWorkingDir: here,
  entryPoints: { view: "src/main.ts" },
  outdir: out,
  bundle: true,
  minify: true,
  format: "iife",
  globalName: "PandaView",
  target: ["es2022"],
  legalComments: "none", // the notice holds all of them
  banner: { js: `/*\n${notice}*/` },
  charset: "utf8",
  write: false,
});
for (const { path, contents } of outputFiles) {
  if (path.endsWith(".css")) writeFileSync(path, contents);
  else {
    const code = {
      sha256: createHash("sha256").update(contents).digest("base64"),
      deflated: deflateSync(contents, { level: 9 }).toString("base64"),
    };
    writeFileSync(join(out, "code.json"), JSON.stringify(code));
  }
}
