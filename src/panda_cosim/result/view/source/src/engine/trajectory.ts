// The controller's commands at any time, as src/panda_cosim/task/trajectory.py has them.
//
// Only operations that round alike everywhere are used, so that all browsers compute the same bits:
// of `Math`, that are `sqrt`, `min` and `max`.

import { rowAt } from "../data/lookup.ts";

type Quat = readonly number[]; // w, x, y, z

export interface TrajectoryData {
  times: number[]; // [s], increasing
  positions: number[][]; // of the hand, world frame [m]
  orientations: Quat[]; // hand to world, each of the sign nearest to the one before
  turns: number[][]; // rotation vector to the next row, world axes [rad]
  grips: number[]; // [m]
  postures: number[][] | null; // joint positions [rad]
  interpolation: string;
  influence: number[][][]; // of each row's values on velocity and acceleration at each row of a spline
}

const TOLERANCE = 1e-9; // [s]; k * dt reaches a row's time even if rounding makes it a little less

export class Trajectory {
  readonly positions: number[][];
  private spline: number[][] | null = null; // by row, see `hermite`

  private readonly instants: Float64Array;

  constructor(private readonly data: TrajectoryData) {
    this.instants = Float64Array.from(data.times);
    this.positions = data.positions.map((place) => [...place]);
    this.use();
  }

  get times(): readonly number[] {
    return this.data.times;
  }

  /** Move a row's position [m]. */
  move(row: number, place: readonly number[]): void {
    this.positions[row] = [...place];
    this.use();
  }

  /** Return the commands: position, orientation, both velocities, grip, then posture and its velocity. */
  sample(time: number): number[] {
    const row = rowAt(this.instants, time + TOLERANCE);
    return this.spline ? this.onSpline(time, row) : this.onSegment(time, row);
  }

  private use(): void {
    const { orientations, postures, influence } = this.data;
    const rows = this.positions.map((place, row) => [...place, ...orientations[row], ...(postures?.[row] ?? [])]);
    const summed = (weights: readonly number[]) => rows.reduce((sum, row, i) => plus(sum, row, weights[i]), scaled(rows[0], 0));
    this.spline = influence.length ? rows.map((row, at) => [row, ...influence.map((weights) => summed(weights[at]))].flat()) : null;
  }

  private onSegment(time: number, row: number): number[] {
    const { times, positions } = this;
    const { orientations, turns, grips, postures, interpolation } = this.data;
    const next = Math.min(row + 1, times.length - 1);
    const duration = next > row ? times[next] - times[row] : 1;
    const u = Math.min(Math.max((time - times[row]) / duration, 0), 1);
    const isLinear = interpolation === "linear";
    const share = isLinear ? u : u * u * u * (10 + u * (6 * u - 15));
    const rate = isLinear ? 0 : (30 * u * u * (1 - u) * (1 - u)) / duration;
    const way = less(positions[next], positions[row]);
    const turn = turns[row];
    const change = postures ? less(postures[next], postures[row]) : [];
    return [
      ...plus(positions[row], way, share),
      ...times4(exponential(scaled(turn, share)), orientations[row]),
      ...scaled(way, rate),
      ...scaled(turn, rate),
      grips[row],
      ...(postures ? [...plus(postures[row], change, share), ...scaled(change, rate)] : []),
    ];
  }

  private onSpline(time: number, row: number): number[] {
    const { times } = this;
    const last = times.length - 1;
    const within = Math.min(Math.max(time, times[0]), times[last]);
    const from = Math.min(row, last - 1);
    const isMoving = time >= times[0] && time <= times[last];
    const [values, rates] = hermite(this.spline!, times, from, within);
    const moved = isMoving ? rates : rates.map(() => 0);
    // The parts of the quaternion leave the unit sphere between rows: q = p / |p|.
    const [p, change] = [values.slice(3, 7), moved.slice(3, 7)];
    const square = p.reduce((sum, part) => sum + part * part, 0);
    const spin = times4(change, inverse(p)).slice(1);
    return [
      ...values.slice(0, 3),
      ...scaled(p, 1 / Math.sqrt(square)),
      ...moved.slice(0, 3),
      ...scaled(spin, 2 / square),
      this.data.grips[row],
      ...values.slice(7),
      ...moved.slice(7),
    ];
  }
}

const plus = (a: readonly number[], b: readonly number[], factor = 1): number[] => a.map((value, i) => value + factor * b[i]);
const less = (a: readonly number[], b: readonly number[]): number[] => plus(a, b, -1);
const scaled = (a: readonly number[], factor: number): number[] => a.map((value) => factor * value);

// Rotations: unit quaternions and rotation vectors.

const inverse = ([w, ...v]: Quat): Quat => [w, ...scaled(v, -1)];

function times4([aw, ax, ay, az]: Quat, [bw, bx, by, bz]: Quat): number[] {
  return [
    aw * bw - ax * bx - ay * by - az * bz,
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
  ];
}

/** Return the quaternion of a rotation by less than a turn. */
function exponential(vector: readonly number[]): number[] {
  const square = vector.reduce((sum, part) => sum + part * part, 0) / 4;
  return [series(square, 0), ...scaled(vector, series(square, 1) / 2)];
}

const TERMS = 30; // beyond which they are below rounding, up to half a turn

/** Return cos(x), or sin(x) / x if the first term is 1, by its power series; the square is x^2. */
function series(square: number, first: 0 | 1): number {
  let [term, sum] = [1, 1];
  for (let k = 2 + first; k < TERMS + first; k += 2) sum += term *= -square / (k * (k - 1));
  return sum;
}

// Splines of degree 5: between two rows a polynomial with the values, velocities and accelerations of both.

/** Return values and rates of all parts at a time between a row and the next. */
function hermite(rows: readonly number[][], times: readonly number[], from: number, time: number): [number[], number[]] {
  const width = rows[0].length / 3;
  const length = times[from + 1] - times[from];
  const u = (time - times[from]) / length;
  const values = new Array<number>(width);
  const rates = new Array<number>(width);
  for (let c = 0; c < width; c++) {
    const [p, q] = [rows[from], rows[from + 1]].map((row) => [row[c], row[c + width] * length, row[c + 2 * width] * length * length]);
    const [d, dv, da] = [q[0] - p[0] - p[1] - p[2] / 2, q[1] - p[1] - p[2], q[2] - p[2]];
    const [c3, c4, c5] = [10 * d - 4 * dv + da / 2, -15 * d + 7 * dv - da, 6 * d - 3 * dv + da / 2];
    values[c] = p[0] + u * (p[1] + u * (p[2] / 2 + u * (c3 + u * (c4 + u * c5))));
    rates[c] = (p[1] + u * (p[2] + u * (3 * c3 + u * (4 * c4 + 5 * u * c5)))) / length;
  }
  return [values, rates];
}
