import assert from "node:assert/strict";
import { test } from "node:test";
import type { RunSource } from "../src/data/source.ts";
import { Loads } from "../src/scene/loads.ts";

const GRAVITY = [0, 0, -9.81];
const free = { parent: 0, joints: [{ kind: "free", address: 0 }], com: [0, 0, 0] };

/** A run whose free body moves as `pose` says: x, y, z and w, x, y, z. */
function moving(pose: (time: number) => number[], { masses = [0, 2] as number[] | null, com = [0, 0, 0], more = [] as object[] } = {}): Loads {
  const model = { nq: 7, gravity: GRAVITY, bodies: [{ parent: 0, joints: [], com }, { ...free, com }, ...more] };
  const run = { model, masses, span: [0, 1], tick: 0.001, pose: (time: number, qpos: Float64Array) => qpos.set(pose(time)) };
  return new Loads(run as unknown as RunSource);
}

function near(actual: number[], expected: number[]): void {
  expected.forEach((value, axis) => assert.ok(Math.abs(actual[axis] - value) < 1e-6, `${actual} is not ${expected}`));
}

test("a body at rest is carried, one that falls freely is not", () => {
  for (const time of [0, 0.3, 1]) {
    near(moving(() => [1, 2, 3, 1, 0, 0, 0]).at(time)[0].force.toArray(), [0, 0, 2 * 9.81]);
    near(moving((t) => [t, 0, 3 - (9.81 / 2) * t * t, 1, 0, 0, 0]).at(time)[0].force.toArray(), [0, 0, 0]);
  }
});

test("a pushed body has the force of its acceleration, at its centre of mass", () => {
  const [load] = moving((t) => [0.1 + 3 * t * t, 0, 0, 0, 0, 0, 1], { com: [0.2, 0, 0] }).at(0.5);
  near(load.force.toArray(), [12, 0, 2 * 9.81]);
  near(load.place.toArray(), [0.1 + 0.75 - 0.2, 0, 0]); // the body is turned round
});

test("a blow between two pictures shows as its mean", () => {
  const speed = (t: number) => [Math.max(t - 0.5, 0), 0, 0, 1, 0, 0, 0]; // 2 kg get 1 m/s at once
  const forces = Array.from({ length: 61 }, (_, frame) => moving(speed).at(frame / 60)[0].force.x);
  near([forces.reduce((sum, force) => sum + force / 60, 0)], [2]); // [N.s]
});

test("bodies of unknown mass, or that carry others, have no arrow", () => {
  assert.equal(moving(() => [], { masses: null }).any, false);
  assert.equal(moving(() => [], { more: [{ parent: 1, joints: [], com: [0, 0, 0] }], masses: [0, 2, 1] }).any, false);
});
