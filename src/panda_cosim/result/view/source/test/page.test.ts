import assert from "node:assert/strict";
import { test } from "node:test";
import { readAddress, writeAddress } from "../src/address.ts";
import { number, quantity } from "../src/dom.ts";
import { Clock } from "../src/clock.ts";

test("an address is read as it was written", () => {
  for (const place of [{ at: 2.3, camera: "front" }, { at: 0, camera: "on the arm & <b>" }, { at: 1.25, camera: "1,2,3,-4,5,6" }])
    assert.deepEqual(readAddress(writeAddress(place)), place);
  assert.deepEqual(readAddress("#t=soon"), {});
  assert.deepEqual(readAddress(""), {});
});

test("numbers are short and have their units", () => {
  assert.deepEqual([0, -1.23456, 1234567, -0.000012345, NaN].map((value) => number(value)), ["0", "−1.235", "1.23e+6", "−1.23e−5", "–"]);
  assert.deepEqual([quantity(0.002, "m"), quantity(2, "m"), quantity(3, "1"), quantity(null, "m")], ["2 mm", "2 m", "3", "not measured"]);
  assert.deepEqual([quantity(4.89e-10, "m"), quantity(1e-6, "m"), number(5e-4), number(4.89e-7, "deg")], ["0 mm", "0.001 mm", "0.0005", "0"]);
});

test("the clock stays within the run, and steps from row to row", () => {
  const clock = new Clock(1, 2, 0.001);
  const seen: number[] = [];
  clock.onTime((time) => seen.push(time));
  clock.seek(9);
  clock.seek(NaN);
  clock.seek(-9);
  clock.seek(1.0104);
  clock.step(1);
  assert.deepEqual(seen.map((time) => Number(time.toFixed(6))), [1, 2, 1, 1.0104, 1.011]);
  clock.extend(3);
  clock.seek(2.5);
  assert.equal(clock.time, 2.5);
});
