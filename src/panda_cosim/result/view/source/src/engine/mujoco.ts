// MuJoCo's module, without Emscripten's own JavaScript: its memory, which the FMUs share, and models.

type Call = (...values: number[]) => number;
type Exports = Record<string, Call> & { memory: WebAssembly.Memory; __indirect_function_table: WebAssembly.Table };

export interface Host {
  hear(words: string): void; // what a module prints
}

const DONE = 0; // of calls to the system
const BAD_FILE = 8;
const PAGE = 65536; // [B] of a memory

/** Answers what modules ask of an operating system: there are no files, and what they print is heard. */
export function system(memory: () => WebAssembly.Memory, hear: (words: string) => void): Record<string, Call> {
  const write: Call = (_file, pieces, count, written) => {
    const data = new DataView(memory().buffer);
    const texts = Array.from({ length: count }, (_, i) => {
      const [at, size] = [data.getUint32(pieces + 8 * i, true), data.getUint32(pieces + 8 * i + 4, true)];
      return new Uint8Array(memory().buffer.slice(at, at + size));
    });
    data.setUint32(written, texts.reduce((sum, { length }) => sum + length, 0), true);
    hear(texts.map((text) => new TextDecoder().decode(text)).join("").trim());
    return DONE;
  };
  const none: Call = (count, size) => {
    for (const place of [count, size]) new DataView(memory().buffer).setUint32(place, 0, true);
    return DONE;
  };
  const clock: Call = (_clock, _precision, time) => {
    new DataView(memory().buffer).setBigUint64(time, BigInt(Math.round(performance.now() * 1e6)), true);
    return DONE;
  };
  return { fd_write: write, environ_sizes_get: none, environ_get: () => DONE, clock_time_get: clock };
}

/** MuJoCo, as long as it has met no fatal error. */
export class MuJoCo {
  private said = "";

  private constructor(readonly functions: Exports) {}

  static async start(module: WebAssembly.Module): Promise<MuJoCo> {
    const made: { engine?: MuJoCo } = {};
    const engine = () => made.engine!;
    const imports: Record<string, Record<string, Call>> = { env: {}, wasi_snapshot_preview1: {} };
    const known: Record<string, Call> = {
      ...system(() => engine().functions.memory, (words) => (engine().said = words || engine().said)),
      emscripten_resize_heap: (size) => engine().grow(size),
      emscripten_get_heap_max: () => 2 ** 31,
      emscripten_get_now: () => performance.now(),
      emscripten_date_now: () => Date.now(),
      emscripten_asm_const_int: () => 0,
      __syscall_openat: () => -BAD_FILE,
    };
    for (const { module: from, name } of WebAssembly.Module.imports(module)) {
      imports[from][name] =
        known[name] ??
        (name.startsWith("invoke_") ? (place, ...values) => engine().invoke(place, values) : /^_embind|^_emval/.test(name) ? () => 0 : () => engine().fail(name));
    }
    const instance = await WebAssembly.instantiate(module, imports);
    made.engine = new MuJoCo(instance.exports as Exports);
    made.engine.functions.emscripten_stack_init();
    made.engine.functions.__wasm_call_ctors();
    return made.engine;
  }

  get bytes(): Uint8Array {
    return new Uint8Array(this.functions.memory.buffer);
  }

  /** Take a block of memory, which is kept. */
  block(size: number): number {
    const place = this.functions.malloc(size);
    if (!place) throw new Error("out of memory");
    return place;
  }

  /** Copy a text into memory. */
  text(words: string): number {
    const bytes = new TextEncoder().encode(`${words}\0`);
    const place = this.block(bytes.length);
    this.bytes.set(bytes, place);
    return place;
  }

  read(place: number): string {
    const bytes = this.bytes;
    return new TextDecoder().decode(bytes.slice(place, bytes.indexOf(0, place)));
  }

  /** Compile MJCF; returns the model as a file of this version (MJB). */
  compiled(mjcf: string): Uint8Array {
    const f = this.functions;
    const [text, why] = [this.text(mjcf), this.block(1000)];
    const spec = f.mj_parseXMLString(text, 0, why, 1000);
    const model = spec && f.mj_compile(spec, 0);
    if (!model) throw new Error(`a model cannot be compiled: ${this.read(spec ? f.mjs_getError(spec) : why)}`);
    const size = f.mj_sizeModel(model);
    const file = this.block(Number(size));
    f.mj_saveModel(model, 0, file, Number(size));
    const content = this.bytes.slice(file, file + Number(size));
    f.mj_deleteModel(model);
    f.mj_deleteSpec(spec);
    for (const place of [text, why, file]) f.free(place);
    return content;
  }

  private grow(size: number): number {
    const { memory } = this.functions;
    return memory.grow(Math.ceil((size - memory.buffer.byteLength) / PAGE)) >= 0 ? 1 : 0;
  }

  /** Call a function of the module's table; a C++ exception or longjmp leaves it as a number. */
  private invoke(place: number, values: number[]): number {
    const f = this.functions;
    const top = f.emscripten_stack_get_current();
    try {
      return (f.__indirect_function_table.get(place) as Call)(...values);
    } catch (error) {
      f._emscripten_stack_restore(top);
      throw error;
    }
  }

  private fail(name: string): never {
    throw new Error(`MuJoCo: ${this.said || name}`);
  }
}
