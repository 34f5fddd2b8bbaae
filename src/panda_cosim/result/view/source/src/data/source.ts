// Interface that scene, curves and panels need of a run: a recording (recorded.ts) or a live
// simulation (live/source.ts), which reports when it has grown.
import type { Criterion, CurveChoice, Limit, Mark, ModelData, Role } from "./types.ts";

/** A curve: values over time [s]; NaN is a gap. */
export interface Series {
  time: Float64Array;
  values: Float64Array;
}

/** A path in the world: points x, y, z in sequence [m], and the time of each point [s]. */
export interface Path {
  time: Float64Array;
  points: Float32Array;
}

export interface Signal {
  name: string;
  columns: string[];
  unit: string;
  words: string;
}

/** Title, verdict and notes of a run. */
export interface About {
  title: string;
  purpose: string;
  facts: string[];
  notes: string[];
  verdict: { state: "good" | "bad" | "plain"; words: string };
  criteria: Criterion[];
  limits: Limit[];
  moments: Mark[];
  waypoints: Mark[];
  curves: CurveChoice[];
}

export interface RunSource {
  readonly name: string;
  readonly about: About;
  /** Null where the run has none, and curves alone are shown. */
  readonly model: ModelData | null;
  /** Masses of the model's bodies [kg], or null where the run may have had others. */
  readonly masses: readonly number[] | null;
  readonly signals: readonly Signal[];
  /** First and last instant [s]; the last may grow. */
  readonly span: readonly [number, number];
  /** Time between two rows [s]. */
  readonly tick: number;
  /** Write the positions at an instant to qpos (nq). */
  pose(time: number, qpos: Float64Array): void;
  /** Return a role's values at an instant, or null if the run has none. */
  at(role: Role, time: number): number[] | null;
  /** Return the path of a role's signal, or null. */
  path(role: Role): Path | null;
  unit(column: string): string;
  bounds(column: string): readonly [number, number] | null;
  /** Return a column's curve; rejects if there is no such column. */
  series(column: string): Promise<Series>;
  /** Call a listener whenever the run has grown; returns a function that stops it. */
  onGrowth(listener: () => void): () => void;
}
