// Decodes columns of numbers; src/panda_cosim/result/view/columns.py encodes them.
import type { Block, TimeData } from "./types.ts";

/** Undo base64 and deflate. */
export async function inflate(text: string): Promise<Uint8Array<ArrayBuffer>> {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Return a block's columns; gaps are NaN. */
export async function decode(block: Block): Promise<Float64Array[]> {
  const bytes = await inflate(block.data);
  return block.steps.map((_, index) => column(block, bytes, index));
}

function column(block: Block, bytes: Uint8Array, index: number): Float64Array {
  const { rows } = block;
  const total = rows * block.steps.length;
  const step = block.steps[index];
  const offset = block.offsets[index];
  const values = new Float64Array(rows);
  let slope = 0;
  let sum = 0;
  for (let row = 0; row < rows; row++) {
    const at = index * rows + row;
    const zigzag =
      bytes[at] | (bytes[total + at] << 8) | (bytes[2 * total + at] << 16) | (bytes[3 * total + at] << 24);
    slope = (slope + ((zigzag >>> 1) ^ -(zigzag & 1))) | 0;
    sum = (sum + slope) | 0;
    values[row] = offset + step * sum;
  }
  for (const [first, end] of block.gaps[index] ?? []) values.fill(NaN, first, end);
  return values;
}

/** Return instants [s]. */
export async function decodeTime(data: TimeData): Promise<Float64Array> {
  if ("block" in data) return (await decode(data.block))[0];
  return Float64Array.from({ length: data.rows }, (_, row) => data.start + data.step * row);
}
