import assert from "node:assert/strict";
import { test } from "node:test";
import type { Curve } from "../src/differences/curve.ts";
import { criterionLines, outside, tubeLines } from "../src/differences/edit.ts";

test("lines are those of scenario.toml, whatever a signal is called", () => {
  assert.equal(tubeLines("plant.qpos[1]", 3e-4), '[regression]\n"plant.qpos[1]" = 0.0003');
  assert.equal(tubeLines('a "b"', 1e-9), '[regression]\n"a \\"b\\"" = 1e-9');
  assert.equal(criterionLines("x", "max", "below", 2.5), '[[success.signal]]\nsignal = "x"\nreduce = "max"\nbelow = 2.5');
});

test("a wider tube has fewer instants outside, and as many more as it is narrower", () => {
  const differences = Float64Array.from([0, 1, 2, 3, -4, NaN]);
  const tube = [-1, 1].map((side) => new Float32Array(6).fill(side * 2)); // lower and upper edge of a tube of 1 around a curve that moves by 1
  const curve = { tolerance: 1, tube, runs: [{ differences }] } as unknown as Curve;
  assert.deepEqual([0.5, 1, 2, 3].map((tolerance) => outside(curve, tolerance)), [4, 3, 2, 1]);
});
