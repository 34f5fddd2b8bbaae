// Writes MuJoCo's module for pages, from npm's package whose version package.json pins:
// `node engine.mjs FILE FUNCTION ...`. It adds C functions to what the module exports, which it
// finds by their names, and leaves out the sections that only debuggers read. The same package
// gives the same bytes.
import { readFileSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const CUSTOM = 0; // identifiers of sections
const EXPORT = 7;
const FUNCTION_NAMES = 1; // of a subsection of the section `name`
const FUNCTION = 0; // kind of an export

/** Reads numbers (LEB128) and texts of a module. */
class Reader {
  constructor(bytes, at = 0) {
    Object.assign(this, { bytes, at });
  }

  get isAtEnd() {
    return this.at >= this.bytes.length;
  }

  number() {
    for (let value = 0, unit = 1; ; unit *= 128) {
      const byte = this.bytes[this.at++];
      value += (byte & 127) * unit;
      if (byte < 128) return value;
    }
  }

  part() {
    const size = this.number();
    this.at += size;
    return this.bytes.subarray(this.at - size, this.at);
  }

  text() {
    return new TextDecoder().decode(this.part());
  }
}

function written(number) {
  const low = number % 128;
  return number < 128 ? [low] : [low + 128, ...written((number - low) / 128)];
}

const prefixed = (bytes) => Buffer.concat([Buffer.from(written(bytes.length)), bytes]);

/** Yield each section: its identifier and content. */
function* sections(module) {
  for (const reader = new Reader(module, 8); !reader.isAtEnd; ) yield [module[reader.at++], reader.part()];
}

/** Return the functions' indices by name, from a custom section; none if it is another one. */
function functionNames(content) {
  const reader = new Reader(content);
  const found = new Map();
  if (reader.text() !== "name") return found;
  while (!reader.isAtEnd) {
    const kind = content[reader.at++];
    const names = new Reader(reader.part());
    if (kind !== FUNCTION_NAMES) continue;
    for (let count = names.number(); count; count--) {
      const index = names.number();
      found.set(names.text(), index);
    }
  }
  return found;
}

function stripped(module, wanted) {
  const custom = [...sections(module)].filter(([kind]) => kind === CUSTOM);
  const indices = new Map(custom.flatMap(([, content]) => [...functionNames(content)]));
  const missing = wanted.filter((name) => !indices.has(name));
  if (missing.length) throw new Error(`the module has no function ${missing.join(", ")}`);
  const more = wanted.map((name) => Buffer.concat([prefixed(Buffer.from(name)), Buffer.from([FUNCTION, ...written(indices.get(name))])]));
  const kept = [...sections(module)].filter(([kind]) => kind !== CUSTOM).map(([kind, content]) => {
    const exported = new Reader(content);
    const body = kind === EXPORT ? Buffer.concat([Buffer.from(written(exported.number() + more.length)), content.subarray(exported.at), ...more]) : content;
    return Buffer.concat([Buffer.from([kind]), prefixed(body)]);
  });
  return Buffer.concat([module.subarray(0, 8), ...kept]);
}

const [file, ...wanted] = process.argv.slice(2);
const here = dirname(fileURLToPath(import.meta.url));
const module = readFileSync(join(here, "node_modules", "@mujoco", "mujoco", "mujoco.wasm"));
const names = new Set(WebAssembly.Module.exports(new WebAssembly.Module(module)).map(({ name }) => name));
writeFileSync(file, stripped(module, wanted.filter((name) => !names.has(name))));
