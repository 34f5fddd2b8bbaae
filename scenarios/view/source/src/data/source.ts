// What scene, curves and panels need of a run. A recording has it (recorded.ts); so may a
// simulation that is still going on, which then says when there is more.
import type { ContactData, Criterion, CurveChoice, Limit, Mark, ModelData, Role } from "./types.ts";

/** A curve: values over instants [s]; NaN is a gap. */
export interface Series {
  time: Float64Array;
  values: Float64Array;
}

/** A path through space: x, y, z one after the other [m], and the instant of each point [s]. */
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

/** A contact: where [m], and the force there [N], world frame. */
export interface Contact {
  place: [number, number, number];
  force: [number, number, number];
}

/** What is said about a run. */
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
  readonly model: ModelData;
  readonly signals: readonly Signal[];
  readonly hasContacts: boolean;
  /** First and last instant [s]; the last may grow. */
  readonly span: readonly [number, number];
  /** Time between two rows [s]. */
  readonly tick: number;
  /** Put the positions at an instant into qpos (nq). */
  pose(time: number, qpos: Float64Array): void;
  /** Return a role's values at an instant, or null where the run has none. */
  at(role: Role, time: number): number[] | null;
  /** Return where a role's signal goes, or null. */
  path(role: Role): Path | null;
  contacts(time: number): Contact[];
  unit(column: string): string;
  bounds(column: string): readonly [number, number] | null;
  /** Return a column's curve; rejects for an unknown one. */
  series(column: string): Promise<Series>;
  /** Call a listener whenever there is more; returns how to stop that. */
  onGrowth(listener: () => void): () => void;
}

export type { ContactData };
