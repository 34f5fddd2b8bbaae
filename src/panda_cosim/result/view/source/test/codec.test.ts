import assert from "node:assert/strict";
import { test } from "node:test";
import { deflateSync } from "node:zlib";
import { decode, decodeTime } from "../src/data/codec.ts";
import { between, mix, rowAt } from "../src/data/lookup.ts";

/** Pack as src/panda_cosim/result/view/columns.py does. */
function pack(columns: number[][]): string {
  const differences = columns.flatMap((column) => {
    const first = column.map((value, row) => value - (column[row - 1] ?? 0));
    return first.map((value, row) => value - (first[row - 1] ?? 0));
  });
  const zigzag = Uint32Array.from(differences, (value) => (value << 1) ^ (value >> 31));
  const bytes = Buffer.from(zigzag.buffer);
  const shuffled = Buffer.from([0, 1, 2, 3].flatMap((byte) => Array.from(zigzag.keys(), (index) => bytes[4 * index + byte])));
  return deflateSync(shuffled).toString("base64");
}

test("columns come back with their steps, offsets and gaps", async () => {
  const whole = [
    [0, 5, -7, 2 ** 29, -(2 ** 29)],
    [1, 1, 1, 1, 1],
  ];
  const block = { rows: 5, steps: [0.5, 2], offsets: [10, 0], gaps: { 1: [[1, 3]] as [number, number][] }, data: pack(whole) };
  const [first, second] = await decode(block);
  assert.deepEqual(Array.from(first), whole[0].map((value) => 10 + value / 2));
  assert.deepEqual(Array.from(second), [2, NaN, NaN, 2, 2]);
});

test("even instants need no column", async () => {
  assert.deepEqual(Array.from(await decodeTime({ start: 1, step: 0.5, rows: 3 })), [1, 1.5, 2]);
});

test("rows are found, and values between them", () => {
  const times = Float64Array.of(0, 1, 3);
  assert.deepEqual([-1, 0, 0.9, 1, 2.9, 3, 9].map((time) => rowAt(times, time)), [0, 0, 0, 1, 1, 2, 2]);
  assert.deepEqual(between(times, 2), [1, 0.5]);
  assert.deepEqual(between(times, 9), [2, 0]);
  assert.deepEqual(between(times, -9), [0, 0]);
  assert.equal(mix(Float64Array.of(0, 10, 20), 1, 0.5), 15);
});
