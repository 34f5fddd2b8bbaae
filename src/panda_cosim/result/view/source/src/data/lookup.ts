// Interpolation between rows.

/** Return the last row at or before an instant; times increase. */
export function rowAt(times: Float64Array, time: number): number {
  let low = 0;
  let high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= time) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** Return the row at or before an instant, and the fraction of the way to the next row, 0 to 1. */
export function between(times: Float64Array, time: number): [number, number] {
  const row = rowAt(times, time);
  if (row + 1 >= times.length) return [row, 0];
  const share = (time - times[row]) / (times[row + 1] - times[row]);
  return [row, Math.min(Math.max(share, 0), 1)];
}

/** Interpolate a column between a row and the next. */
export function mix(values: Float64Array, row: number, share: number): number {
  const here = values[row];
  return share > 0 ? here + share * (values[row + 1] - here) : here;
}
