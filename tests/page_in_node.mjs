// Runs the worker of a page that simulates by itself: `node page_in_node.mjs PAGE.html COMMANDS`,
// the latter as a JSON list; prints what it told. The worker is paused before its first tick.
import { readFileSync } from "node:fs";
import { inflateSync } from "node:zlib";

const [, , path, given] = process.argv;
const page = readFileSync(path, "utf8");
const part = (name) => page.match(new RegExp(`<script[^>]* data-${name}>(.*?)</script>`, "s"))[1];
const modules = [...page.matchAll(/ data-module="(\w+)">(.*?)<\/script>/gs)].map(([, name, text]) => [name, text]);
const told = { rows: [], status: null, plan: null, refused: [], journal: null };

globalThis.postMessage = (message) => {
  if (typeof message !== "string") return told.rows.push(Array.from(new Float64Array(message)));
  const [[kind, content]] = Object.entries(JSON.parse(message));
  if (kind === "refused") told.refused.push(content);
  else told[kind] = content;
  if (kind === "journal") process.stdout.write(JSON.stringify(told), () => process.exit(0));
};
(0, eval)(inflateSync(Buffer.from(part("worker"), "base64")).toString());
const [live, engine] = ["live", "engine"].map((name) => JSON.parse(part(`view="&quot;${name}&quot;"`)));
const { tunables, columns, plan } = live;
onmessage({ data: { data: { ...engine, tunables, columns, plan }, modules: Object.fromEntries(modules) } });
for (const command of [{ do: "pause" }, ...JSON.parse(given), { do: "journal" }]) onmessage({ data: JSON.stringify(command) });
