// Writes a zip archive of texts, not compressed.

const DATE = (46 << 9) | (1 << 5) | 1; // 2026-01-01, as FAT has it

const TABLE = Uint32Array.from({ length: 256 }, (_, byte) => {
  let value = byte;
  for (let bit = 0; bit < 8; bit++) value = value & 1 ? (value >>> 1) ^ 0xedb88320 : value >>> 1;
  return value;
});

/** CRC-32 of some bytes. */
function checksum(bytes: Uint8Array): number {
  return ~bytes.reduce((value, byte) => TABLE[(value ^ byte) & 255] ^ (value >>> 8), 0xffffffff) >>> 0;
}

/** Write numbers, little-endian, of some bytes each. */
function written(...fields: [value: number, size: number][]): Uint8Array<ArrayBuffer> {
  return Uint8Array.from(fields.flatMap(([value, size]) => Array.from({ length: size }, (_, i) => (value / 256 ** i) & 255)));
}

const sizeOf = (parts: readonly Uint8Array[]): number => parts.reduce((sum, { length }) => sum + length, 0);

/** Return the parts of an archive of files by their paths. */
export function zip(files: Record<string, string>): Uint8Array<ArrayBuffer>[] {
  const local: Uint8Array<ArrayBuffer>[] = [];
  const central: Uint8Array<ArrayBuffer>[] = [];
  for (const [path, text] of Object.entries(files)) {
    const [name, content] = [path, text].map((words) => new TextEncoder().encode(words));
    const about: [number, number][] = [[20, 2], [0x0800, 2], [0, 2], [0, 2], [DATE, 2], [checksum(content), 4], [content.length, 4], [content.length, 4], [name.length, 2], [0, 2]]; // prettier-ignore
    central.push(written([0x02014b50, 4], [20, 2], ...about, [0, 2], [0, 2], [0, 2], [0, 4], [sizeOf(local), 4]), name);
    local.push(written([0x04034b50, 4], ...about), name, content);
  }
  const count = Object.keys(files).length;
  const end = written([0x06054b50, 4], [0, 2], [0, 2], [count, 2], [count, 2], [sizeOf(central), 4], [sizeOf(local), 4], [0, 2]);
  return [...local, ...central, end];
}
