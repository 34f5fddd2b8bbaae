// Forces on free bodies besides their weights, from their motion: what holds, pushes and stops them.
import { Vector3 } from "three";
import type { RunSource } from "../data/source.ts";
import { quaternion } from "./kinematics.ts";

const SPAN = 1 / 60; // [s] the force is a mean over twice that, so that no impact falls between two pictures

/** A force [N] on a body, and its centre of mass [m], both in the world. */
export interface Load {
  place: Vector3;
  force: Vector3;
}

interface FreeBody {
  address: number; // of its joint in qpos
  mass: number; // [kg]
  com: Vector3; // in its frame [m]
}

export class Loads {
  private readonly free: FreeBody[];
  private readonly qpos: Float64Array;

  constructor(private readonly run: RunSource) {
    const { bodies, nq } = run.model!;
    const parents = new Set(bodies.map(({ parent }) => parent));
    this.free = bodies.flatMap(({ joints, com }, index) =>
      run.masses && joints.length === 1 && joints[0].kind === "free" && !parents.has(index)
        ? [{ address: joints[0].address, mass: run.masses[index], com: new Vector3(...com) }]
        : [],
    );
    this.qpos = new Float64Array(nq);
  }

  /** Whether there are such bodies, of known masses. */
  get any(): boolean {
    return this.free.length > 0;
  }

  /** Return the forces around an instant: m (a - g), with a from three places of the centre of mass. */
  at(time: number): Load[] {
    const [start, end] = this.run.span;
    const step = Math.max(SPAN, this.run.tick);
    if (end - start < 2 * step) return [];
    const middle = Math.min(Math.max(time, start + step), end - step);
    const [before, now, after] = [middle - step, middle, middle + step].map((instant) => this.places(instant));
    const gravity = new Vector3(...this.run.model!.gravity);
    return this.places(time).map((place, index) => {
      const force = before[index].add(after[index]).addScaledVector(now[index], -2).divideScalar(step * step);
      return { place, force: force.sub(gravity).multiplyScalar(this.free[index].mass) };
    });
  }

  private places(time: number): Vector3[] {
    const { qpos } = this;
    this.run.pose(time, qpos);
    return this.free.map(({ address: at, com }) => {
      const turn = quaternion([qpos[at + 3], qpos[at + 4], qpos[at + 5], qpos[at + 6]]).normalize();
      return com.clone().applyQuaternion(turn).add(new Vector3(qpos[at], qpos[at + 1], qpos[at + 2]));
    });
  }
}
