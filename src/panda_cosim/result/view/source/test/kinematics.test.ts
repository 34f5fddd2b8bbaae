import assert from "node:assert/strict";
import { test } from "node:test";
import { Quaternion, Vector3 } from "three";
import type { BodyData, JointData, ModelData } from "../src/data/types.ts";
import { Kinematics } from "../src/scene/kinematics.ts";

const still = { parent: 0, fixed: false, pos: [0, 0, 0], quat: [1, 0, 0, 0], shapes: [], joints: [] };

function model(...bodies: Partial<BodyData>[]): ModelData {
  const world = { ...still, name: "world" };
  return { bodies: [world, ...bodies.map((body) => ({ ...still, name: "", ...body }))] } as unknown as ModelData;
}

function joint(kind: JointData["kind"], more: Partial<JointData> = {}): JointData {
  return { name: "", kind, address: 0, axis: [0, 0, 1], pos: [0, 0, 0], zero: 0, range: [], ...more };
}

function posed(data: ModelData, qpos: number[]): { position: Vector3; quaternion: Quaternion }[] {
  const frames = data.bodies.map(() => ({ position: new Vector3(), quaternion: new Quaternion() }));
  new Kinematics(data).pose(qpos, frames);
  return frames;
}

function near(actual: Vector3, expected: number[]): void {
  assert.ok(actual.distanceTo(new Vector3(...expected)) < 1e-12, `${actual.toArray()} is not ${expected}`);
}

test("a hinge turns about its anchor, from the position at which the model stands", () => {
  const [, body] = posed(model({ pos: [1, 0, 0], joints: [joint("hinge", { pos: [1, 0, 0], zero: 0.5 })] }), [0.5 + Math.PI / 2]);
  near(body.position, [2, -1, 0]);
});

test("a slide moves along its axis in the parent's frame", () => {
  const half = Math.SQRT1_2;
  const [, body] = posed(model({ quat: [half, 0, 0, half], joints: [joint("slide", { axis: [2, 0, 0] })] }), [3]);
  near(body.position, [0, 3, 0]);
});

test("a child goes with its parent, a free body where qpos says", () => {
  const frames = posed(model({ joints: [joint("free")] }, { parent: 1, pos: [1, 0, 0] }), [1, 2, 3, 0, 0, 0, 2]);
  near(frames[1].position, [1, 2, 3]);
  near(frames[2].position, [0, 2, 3]);
});

test("a ball turns by its quaternion, whatever its length", () => {
  const [, body] = posed(model({ joints: [joint("ball", { pos: [0, 1, 0] })] }), [0, 0, 0, 5]);
  near(body.position, [0, 2, 0]);
});
