// A live run, in the form that scene and curves read.
import { between, mix } from "../data/lookup.ts";
import type { About, Path, RunSource, Series, Signal } from "../data/source.ts";
import type { ModelData, Role } from "../data/types.ts";
import type { Plan, Tunable } from "./link.ts";
import type { Push } from "./drag.ts";

/** The run's data in the page when it is opened. */
export interface LiveData {
  name: string;
  about: About;
  model: ModelData;
  masses: number[] | null;
  signals: (Signal & { units: string[] })[];
  columns: string[]; // of a row, `time` first
  roles: Partial<Record<Role, string[]>>;
  bounds: Record<string, [number, number]>;
  duration: number;
  row: number[];
  tunables: Tunable[];
  couplings: string[];
  pushes: Push[];
  plan: Plan;
}

const ERROR: Signal & { units: string[] } = { name: "tracking error", columns: ["tracking error"], unit: "mm", units: ["mm"], words: "Distance of the hand from its command" };
const MOST = 30_000; // rows kept in the browser; the recording has all
const SPARE = 1000;

export class LiveRun implements RunSource {
  readonly name: string;
  readonly about: About;
  readonly model: ModelData;
  readonly masses: readonly number[] | null;
  readonly signals: readonly Signal[];
  readonly tick = 0.001;
  private readonly index: Map<string, number>;
  private readonly units = new Map<string, string>();
  private readonly listeners = new Set<() => void>();
  private rows: Float64Array[];
  private instants: Float64Array | null = null; // times of the rows, computed on demand
  private way: Path = { time: new Float64Array(), points: new Float32Array() };

  constructor(private readonly data: LiveData) {
    this.name = data.name;
    this.about = { ...data.about };
    this.use(data.plan);
    this.model = data.model;
    this.masses = data.masses;
    this.signals = this.canTrack ? [ERROR, ...data.signals] : data.signals;
    this.index = new Map([...data.columns, ERROR.name].map((column, at) => [column, at]));
    for (const { columns, units } of [ERROR, ...data.signals]) columns.forEach((column, at) => this.units.set(column, units[at]));
    this.rows = [this.tracked(Float64Array.from(data.row))];
  }

  private get canTrack(): boolean {
    return this.data.roles.actual?.length === 3 && this.data.roles.commanded?.length === 3;
  }

  /** Return a row with the tracking error at its end [mm]. */
  private tracked(row: Float64Array): Float64Array {
    const place = (role: Role) => this.data.roles[role]!.map((column) => row[this.index.get(column)!]);
    const whole = new Float64Array(row.length + 1);
    whole.set(row);
    if (!this.canTrack) return whole;
    const [actual, commanded] = [place("actual"), place("commanded")];
    whole[row.length] = 1e3 * Math.hypot(...actual.map((value, axis) => value - commanded[axis]));
    return whole;
  }

  get span(): readonly [number, number] {
    return [this.rows[0][0], this.rows[this.rows.length - 1][0]];
  }

  private get times(): Float64Array {
    return (this.instants ??= Float64Array.from(this.rows, (row) => row[0]));
  }

  /** Append rows; an earlier time starts a new run. Call `grown` afterwards. */
  take(values: Float64Array): void {
    const width = this.data.columns.length;
    for (let at = 0; at + width <= values.length; at += width) {
      const row = this.tracked(values.subarray(at, at + width));
      while (this.rows.length && this.rows[this.rows.length - 1][0] >= row[0]) this.rows.pop();
      this.rows.push(row);
    }
    if (this.rows.length > MOST + SPARE) this.rows.splice(0, this.rows.length - MOST);
    this.instants = null;
  }

  /** Notify the listeners of new rows. */
  grown(): void {
    for (const listener of this.listeners) listener();
  }

  /** Replace the commanded path. */
  use({ time, points, waypoints }: Plan): void {
    this.way = { time: Float64Array.from(time), points: Float32Array.from(points) };
    this.about.waypoints = waypoints;
  }

  /** Return a column's latest value. */
  newest(column: string): number {
    return this.rows[this.rows.length - 1][this.index.get(column)!];
  }

  pose(time: number, qpos: Float64Array): void {
    this.values(this.data.roles.qpos!, time).forEach((value, index) => (qpos[index] = value));
  }

  at(role: Role, time: number): number[] | null {
    const columns = this.data.roles[role];
    return columns ? this.values(columns, time) : null;
  }

  path(role: Role): Path | null {
    return role === "commanded" ? this.way : null; // the hand's own path is not known yet
  }

  unit(column: string): string {
    return this.units.get(column) ?? "";
  }

  bounds(column: string): readonly [number, number] | null {
    return this.data.bounds[column] ?? null;
  }

  series(column: string): Promise<Series> {
    const at = this.index.get(column);
    if (at === undefined) return Promise.reject(new Error(`no signal ${column}`));
    return Promise.resolve({ time: this.times, values: Float64Array.from(this.rows, (row) => row[at]) });
  }

  onGrowth(listener: () => void): () => void {
    this.listeners.add(listener);
    return () => this.listeners.delete(listener);
  }

  private values(columns: readonly string[], time: number): number[] {
    const [row, share] = between(this.times, time);
    const next = this.rows[Math.min(row + 1, this.rows.length - 1)];
    return columns.map((column) => {
      const at = this.index.get(column)!;
      return mix(Float64Array.of(this.rows[row][at], next[at]), 0, share);
    });
  }
}
