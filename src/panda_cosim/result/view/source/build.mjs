// Builds ../page/code.json with the code of each page, and a style sheet for each, and collects the
// licences of the bundled libraries. `node build.mjs [FOLDER]` writes elsewhere. The same versions
// give the same code.
import { build } from "esbuild";
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join, relative } from "node:path";
import { fileURLToPath } from "node:url";
import { deflateSync } from "node:zlib";

const here = dirname(fileURLToPath(import.meta.url));
const out = process.argv[2] ?? join(here, "..", "page");
const libraries = ["three", "uplot"];
const pages = {
  view: ["src/main.ts", "PandaView"],
  sweep: ["src/sweep/main.ts", "PandaSweep"],
  differences: ["src/differences/main.ts", "PandaDifferences"],
  worker: ["src/engine/worker.ts", "PandaWorker"],
};

const palette = JSON.parse(readFileSync(join(here, "../../palette.json"), "utf8"));

/** Puts the colours of a scheme in where a style sheet says `@palette SCHEME;`. */
const colours = {
  name: "palette",
  setup: ({ onLoad }) => onLoad({ filter: /\.css$/ }, ({ path }) => ({
    loader: "css",
    contents: readFileSync(path, "utf8").replace(/@palette (\w+);/g, (_, scheme) =>
      Object.entries(palette[scheme]).map(([name, colour]) => `--${name}: ${colour};`).join(" ")),
  })),
};

const licences = new Map(libraries.map((name) => {
  const folder = join(here, "node_modules", name);
  const { version } = JSON.parse(readFileSync(join(folder, "package.json"), "utf8"));
  return [name, `${name} ${version}\n\n${readFileSync(join(folder, "LICENSE"), "utf8").trim()}\n`];
}));

function notice(names) {
  const texts = names.map((name) => licences.get(name));
  return `Contains the following libraries, each under its own licence.\n\n${texts.join(`\n${"-".repeat(78)}\n\n`)}`;
}

/** Build a page's code, and its style sheet if it has one. */
async function built(name, entry, globalName) {
  const { outputFiles, metafile } = await build({
    absWorkingDir: here,
    entryPoints: { [name]: entry },
    outdir: out,
    bundle: true,
    minify: true,
    format: "iife",
    globalName,
    target: ["es2022"],
    legalComments: "none", // the notice holds all of them
    charset: "utf8",
    plugins: [colours],
    write: false,
    metafile: true,
  });
  const file = (suffix) => outputFiles.find(({ path }) => path.endsWith(suffix));
  if (file(".css")) writeFileSync(join(out, `${name}.css`), file(".css").contents);
  const inputs = Object.keys(metafile.outputs[relative(here, file(".js").path)].inputs);
  const used = libraries.filter((library) => inputs.some((path) => path.startsWith(`node_modules/${library}/`)));
  return (used.length ? `/*\n${notice(used)}*/\n` : "") + file(".js").text.trim();
}

const digest = (text) => createHash("sha256").update(text).digest("base64");

mkdirSync(out, { recursive: true });
writeFileSync(join(out, "LICENSES.txt"), notice(libraries));
const loader = await built("loader", "src/loader.ts");
const code = { loader: { sha256: digest(loader), text: loader } };
for (const [name, [entry, globalName]] of Object.entries(pages)) {
  const text = await built(name, entry, globalName);
  code[name] = { sha256: digest(text), deflated: deflateSync(text, { level: 9 }).toString("base64") };
}
writeFileSync(join(out, "code.json"), JSON.stringify(code));
