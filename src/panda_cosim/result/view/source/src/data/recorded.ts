// A recorded run, from the page's data. Columns are decoded when they are first needed.
import { decode, decodeTime } from "./codec.ts";
import { between, mix } from "./lookup.ts";
import type { About, Path, RunSource, Series, Signal } from "./source.ts";
import type { ModelData, Role, RunData } from "./types.ts";

type Columns = Map<string, Float64Array>;

export class RecordedRun implements RunSource {
  readonly name: string;
  readonly about: About;
  readonly masses: readonly number[] | null;
  readonly signals: readonly Signal[];
  readonly span: readonly [number, number];
  readonly tick: number;
  private readonly signalOf = new Map<string, number>();
  private readonly unpacked = new Map<number, Promise<Float64Array[]>>();

  private constructor(
    private readonly data: RunData,
    readonly model: ModelData | null,
    private readonly curveTime: Float64Array,
    private readonly poseTime: Float64Array,
    private readonly poses: Columns,
  ) {
    this.name = data.name;
    this.about = data;
    this.masses = data.masses;
    this.signals = data.signals.map(({ name, columns, units, words }) => ({ name, columns, words, unit: units[0] }));
    this.span = [poseTime[0], poseTime[poseTime.length - 1]];
    this.tick = poseTime.length > 1 ? (this.span[1] - this.span[0]) / (poseTime.length - 1) : 0.001;
    data.signals.forEach(({ columns }, index) => columns.forEach((column) => this.signalOf.set(column, index)));
  }

  static async open(data: RunData, model: ModelData | null): Promise<RecordedRun> {
    const curveTime = await decodeTime(data.time);
    const poseTime = data.poses ? await decodeTime(data.poses.time) : curveTime;
    return new RecordedRun(data, model, curveTime, poseTime, await poseColumns(data));
  }

  pose(time: number, qpos: Float64Array): void {
    const [row, share] = between(this.poseTime, time);
    this.data.roles.qpos!.forEach((column, index) => (qpos[index] = mix(this.poses.get(column)!, row, share)));
  }

  at(role: Role, time: number): number[] | null {
    const columns = this.data.roles[role];
    if (!columns) return null;
    const [row, share] = between(this.poseTime, time);
    return columns.map((column) => mix(this.poses.get(column)!, row, share));
  }

  path(role: Role): Path | null {
    const columns = this.data.roles[role]?.map((column) => this.poses.get(column)!);
    if (columns?.length !== 3) return null;
    const points = new Float32Array(3 * this.poseTime.length);
    columns.forEach((values, axis) => values.forEach((value, row) => (points[3 * row + axis] = value)));
    return { time: this.poseTime, points };
  }

  unit(column: string): string {
    const signal = this.data.signals[this.signalOf.get(column) ?? -1];
    return signal ? signal.units[signal.columns.indexOf(column)] : "";
  }

  bounds(column: string): readonly [number, number] | null {
    return this.data.bounds[column] ?? null;
  }

  async series(column: string): Promise<Series> {
    const index = this.signalOf.get(column);
    if (index === undefined) throw new Error(`no signal ${column}`);
    if (!this.unpacked.has(index)) this.unpacked.set(index, decode(this.data.signals[index]));
    const columns = await this.unpacked.get(index)!;
    return { time: this.curveTime, values: columns[this.data.signals[index].columns.indexOf(column)] };
  }

  onGrowth(): () => void {
    return () => undefined; // a recording does not grow
  }
}

/** Return the columns that the scene needs, from the poses of a thinned run or from its signals. */
async function poseColumns(data: RunData): Promise<Columns> {
  const found: Columns = new Map();
  const wanted = new Set(Object.values(data.roles).flat());
  const blocks = data.poses ? [data.poses] : data.signals.filter(({ columns }) => columns.some((c) => wanted.has(c)));
  for (const block of blocks) {
    const values = await decode(block);
    block.columns.forEach((column, index) => found.set(column, withoutGaps(values[index])));
  }
  return found;
}

/** Hold the last finite value over gaps, since every body needs a pose. */
function withoutGaps(values: Float64Array): Float64Array {
  let last = 0;
  return values.map((value) => (Number.isFinite(value) ? (last = value) : last));
}
