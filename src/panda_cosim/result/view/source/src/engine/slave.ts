// An FMU as a module beside MuJoCo's: calls of FMI 3.0, and the rows that it reads and writes.
import type { Tunable } from "../live/link.ts";
import { type MuJoCo, system } from "./mujoco.ts";

type Call = (...values: number[]) => number;
type Exports = Record<string, Call> & Record<"__global_base" | "__heap_base", WebAssembly.Global>;

/** An input and what feeds it: the column of a value, with factor and offset on its way. */
export type Feed = [reference: number, column: number, factor: number, offset: number];

export interface SlaveData {
  name: string; // of the instance, and of its module
  token: string;
  table: string; // variables and options, with the scenario's start values
  models: Record<string, string>; // MJCF by the name of the resource that is compiled of it
  feeds: Feed[];
  outputs: [reference: number, column: number][];
}

const OK = 1; // the highest status that is no failure
// By the kind of a parameter.
const SETTERS: Record<string, string> = { Real: "fmi3SetFloat64", Boolean: "fmi3SetBoolean", Enumeration: "fmi3SetInt64" };

/** A failure that ends the run: of an FMU at an instant. */
export class SimulationError extends Error {}

/** Values of an FMU's variables, in the memory that it shares. */
class Values {
  private readonly references: number;
  private readonly place: number;
  private view = new Float64Array();

  constructor(
    private readonly engine: MuJoCo,
    references: readonly number[],
  ) {
    const { length } = references;
    this.references = engine.block(4 * length);
    new Uint32Array(engine.bytes.buffer, this.references, length).set(references);
    this.place = engine.block(8 * length);
    this.count = length;
  }

  readonly count: number;

  get arguments(): [number, number, number, number] {
    return [this.references, this.count, this.place, this.count];
  }

  get numbers(): Float64Array {
    const { buffer } = this.engine.functions.memory; // another one once it has grown
    if (this.view.buffer !== buffer) this.view = new Float64Array(buffer, this.place, this.count);
    return this.view;
  }
}

export class Slave {
  readonly inputs: ReadonlySet<number>; // columns
  readonly outputs: readonly number[];
  private readonly read: Values;
  private readonly written: Values;
  private readonly flags: number;
  private instance = 0;
  private said = "";
  private f!: Exports;

  private constructor(
    private readonly engine: MuJoCo,
    readonly data: SlaveData,
  ) {
    this.inputs = new Set(data.feeds.map(([, column]) => column));
    this.outputs = data.outputs.map(([, column]) => column);
    this.written = new Values(engine, data.feeds.map(([reference]) => reference));
    this.read = new Values(engine, data.outputs.map(([reference]) => reference));
    this.flags = engine.block(32);
  }

  /** Instantiate an FMU; its data lie in a part of a block that it was linked for. */
  static async open(engine: MuJoCo, module: WebAssembly.Module, block: readonly [number, number], data: SlaveData): Promise<Slave> {
    const slave = new Slave(engine, data);
    const { memory } = engine.functions;
    const files = new Map(Object.entries(data.models).map(([name, mjcf]) => [`/${name}`, engine.compiled(mjcf)]));
    files.set("/variables.txt", new TextEncoder().encode(data.table));
    const page: Record<string, Call> = {
      size: (path) => files.get(engine.read(path))?.length ?? -1,
      read: (path, to) => (engine.bytes.set(files.get(engine.read(path))!, to), 0),
      log: (_status, text) => ((slave.said = engine.read(text)), 0),
    };
    const wasi = new Proxy(system(() => memory, (words) => (slave.said = words)), { get: (known, name: string) => known[name] ?? (() => 0) });
    const imports = { env: { memory }, mujoco: engine.functions, page, wasi_snapshot_preview1: wasi };
    slave.f = (await WebAssembly.instantiate(module, imports)).exports as Exports;
    const [first, end] = [slave.f.__global_base, slave.f.__heap_base].map((place) => Number(place.value));
    if (first < block[0] || end > block[1]) throw new Error(`${data.name}: the engine's memory begins at another place than it was made for`);
    slave.f._initialize();
    slave.instance = slave.f.page_instantiate(...([data.name, data.token, "/"].map((words) => engine.text(words)) as [number, number, number]));
    if (!slave.instance) throw new SimulationError(`${data.name}: ${slave.said}`);
    return slave;
  }

  enterInitialization(): void {
    this.call("fmi3EnterInitializationMode", 0, 0, 0, 0, 0);
  }

  exitInitialization(): void {
    this.call("fmi3ExitInitializationMode");
  }

  /** Go back to before the initialization, with the start values. */
  reset(): void {
    this.call("fmi3Reset");
  }

  step(time: number, size: number): void {
    const { flags } = this;
    this.call("fmi3DoStep", time, size, 0, flags, flags + 1, flags + 2, flags + 8);
  }

  setInputs(row: Float64Array): void {
    const { numbers, arguments: place } = this.written;
    this.data.feeds.forEach(([, column, factor, offset], i) => (numbers[i] = factor * row[column] + offset));
    if (numbers.length) this.call("fmi3SetFloat64", ...place);
  }

  getOutputs(row: Float64Array): void {
    this.call("fmi3GetFloat64", ...this.read.arguments);
    const { numbers } = this.read;
    for (let i = 0; i < numbers.length; i++) row[this.outputs[i]] = numbers[i];
  }

  /** Whether an output of this slave is an input of another. */
  feeds(other: Slave): boolean {
    return this.outputs.some((column) => other.inputs.has(column));
  }

  /** Set a parameter; the number of an enumeration's item counts from 1. */
  set({ reference, kind }: Tunable, value: number): void {
    const one = new Values(this.engine, [reference]);
    const [references, count, place] = one.arguments;
    const memory = new DataView(this.engine.functions.memory.buffer);
    if (kind === "Real") memory.setFloat64(place, value, true);
    else memory.setBigInt64(place, BigInt(value), true); // a Boolean is its first byte
    this.call(SETTERS[kind], references, count, place, 1);
    for (const used of [references, place]) this.engine.functions.free(used);
  }

  private call(name: string, ...values: number[]): void {
    if (this.f[name](this.instance, ...values) > OK) throw new SimulationError(`${this.data.name}: ${this.said || name}`);
  }
}
