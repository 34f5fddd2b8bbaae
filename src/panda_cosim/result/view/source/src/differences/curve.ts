// A column's curves in all runs; src/panda_cosim/study/compare/page.py encodes them.
interface CurveData {
  unit: string;
  names: string[]; // of the first run or the reference, and of the others
  tolerance: number | null;
  worst: number; // [s]
  time: [step: number, count: number][]; // from one instant to the next [us], the first from 0
  baseline: string;
  runs: string[];
  tube: [string, string] | null;
}

/** A run, and how far it is from the first one. */
export interface Run {
  name: string;
  values: Float64Array;
  differences: Float64Array;
}

export class Curve {
  readonly unit: string;
  readonly name: string;
  readonly tolerance: number | null;
  readonly worst: number;
  readonly time: Float64Array;
  readonly baseline: Float32Array;
  readonly runs: readonly Run[];
  /** Edges of the tube as differences from the baseline: none, or the lower and the upper one. */
  readonly tube: readonly Float32Array[];
  /** The first and the last row of each stretch in which a run has no difference. */
  readonly gaps: readonly [number, number][];
  readonly span: readonly [number, number];
  /** The least time between two rows, at most 1 ms [s]. */
  readonly step: number;

  constructor(data: CurveData) {
    this.unit = data.unit;
    this.tolerance = data.tolerance;
    this.worst = data.worst;
    this.time = instants(data.time);
    this.baseline = floats(data.baseline);
    this.tube = (data.tube ?? []).map(floats);
    const [name, ...others] = data.names;
    this.name = name;
    this.runs = data.runs.map((text, index) => this.run(others[index], floats(text)));
    this.gaps = stretches(this.time.length, (row) => this.runs.some(({ differences }) => !Number.isFinite(differences[row])));
    this.step = this.time.reduce((least, time, row) => (row ? Math.min(least, time - this.time[row - 1]) : least), 1e-3);
    const begin = this.time[0];
    this.span = [begin, Math.max(this.time[this.time.length - 1], begin + this.step)];
  }

  /** Runs are stored as differences from the baseline, or as they are where that has no value. */
  private run(name: string, stored: Float32Array): Run {
    const from = (row: number) => (Number.isFinite(this.baseline[row]) ? this.baseline[row] : null);
    return {
      name,
      values: Float64Array.from(stored, (value, row) => value + (from(row) ?? 0)),
      differences: Float64Array.from(stored, (value, row) => (from(row) === null ? NaN : value)),
    };
  }
}

function instants(steps: CurveData["time"]): Float64Array {
  let now = 0;
  return Float64Array.from(steps.flatMap(([step, count]) => Array<number>(count).fill(step)), (step) => (now += step) / 1e6);
}

function floats(text: string): Float32Array {
  return new Float32Array(Uint8Array.from(atob(text), (char) => char.charCodeAt(0)).buffer);
}

/** Return the first and the last row of each stretch of rows that pass a test. */
function stretches(rows: number, test: (row: number) => boolean): [number, number][] {
  const found: [number, number][] = [];
  for (let row = 0; row < rows; row++) {
    if (!test(row)) continue;
    const last = found[found.length - 1];
    if (last?.[1] === row - 1) last[1] = row;
    else found.push([row, row]);
  }
  return found;
}
