// A metric over two keys: cells, or a mark for each row.
import { css, isLight, type Rgb, shade, SHADES } from "../colours.ts";
import { draw, make } from "../dom.ts";
import { type Box, canvas, frame, keyAxis, type Tick, wide } from "./axes.ts";
import { called, type Cells, data, drawingOrder, ends, FAILURES, fit, hasFailures, known, number, state, title, withUnit } from "./data.ts";
import { crosses, dark, mark } from "./marks.ts";

type Paint = (v: number) => Rgb;
const GREY: Rgb = [128, 128, 128]; // about that of a cell without a value

export function map(into: HTMLElement, shades: HTMLElement): void {
  const at = data.maps[state.pair];
  const { metric } = state;
  const [first, second] = at.keys;
  const shares = metric === FAILURES;
  const asCells = shares || at.keys.every((key) => data.marginals[key].each);
  const high = asCells ? Math.min(Math.max(at.names[1].length * 58, 200), 440) + 80 : 460;
  const [plot, box] = canvas(into, high, `${title(metric)} over ${title(first)} and ${title(second)}`);
  const texts = asCells ? at.ticks[1] : keyAxis(second, 0, 300).ticks.map(([text]) => text);
  box.left = 14 + Math.min(wide([...texts, "00"]), 0.3 * (box.right + 10));
  const [lowest, highest] = shares ? [0, 100] : ends(known(data.points[metric]));
  const hues = !shares ? SHADES : dark.matches ? [[31, 39, 50], [255, 123, 136]] : [[232, 236, 241], [209, 41, 61]];
  const paint: Paint = (v) => shade((v - lowest) / (highest - lowest || 1), hues);
  if (asCells) cells(plot, box, at, metric, paint);
  else marks(plot, box, at, data.points[metric], paint);
  const strip = make("i", "strip");
  strip.style.background = `linear-gradient(90deg, ${hues.map(css).join(", ")})`;
  const words = (v: number) => (shares ? `${v} %` : withUnit(number(v), metric));
  const key = hasFailures && !shares ? [crosses()] : [];
  shades.replaceChildren(make("span", "", `${called(metric)}: ${words(lowest)}`), strip, make("span", "", words(highest)), ...key);
}

function marks(plot: SVGElement, box: Box, { keys: [first, second] }: Cells, values: readonly (number | null)[], paint: Paint): void {
  const x = keyAxis(first, box.left, box.right);
  const y = keyAxis(second, box.bottom, box.top);
  frame(plot, box, x, y.ticks, [title(first), title(second)]);
  const size = values.length > 1000 ? 3 : values.length > 200 ? 4.5 : 7;
  for (const row of drawingOrder) {
    const v = values[row];
    mark(plot, row, x.at(data.points[first][row]!), y.at(data.points[second][row]!), size, v === null ? "var(--soft)" : css(paint(v)));
  }
}

/** Places of cells side by side, and their names. */
function sized(names: readonly string[], from: number, to: number) {
  const size = (to - from) / names.length;
  const ticks = names.map((name, i): Tick => [name, from + (i + 0.5) * size]).filter(([name]) => name);
  return { size: Math.abs(size), at: (i: number) => from + i * size, ticks };
}

function cells(plot: SVGElement, box: Box, at: Cells, metric: string, paint: Paint): void {
  const [first, second] = at.keys;
  const down = at.names[1].length; // its own parts: the bars of one key are finer
  const shares = metric === FAILURES;
  const x = sized(at.ticks[0], box.left, box.right);
  const y = sized(at.ticks[1], box.bottom, box.top);
  const beside = y.ticks.map(([name, place]): Tick => [fit(name, Math.floor((box.left - 10) / 6.5)), place]);
  frame(plot, box, x, beside, [title(first), title(second)]);
  const values = shares ? at.rows.map((rows, cell) => (rows ? (100 * at.bad[cell]) / rows : undefined)) : means(at, metric);
  const rect = (cx: number, cy: number, inset: number, more: Record<string, string | number>) =>
    draw(plot, "rect", { x: cx + inset, y: cy + inset, width: Math.max(x.size - 2 * inset, 1), height: Math.max(y.size - 2 * inset, 1), ...more });
  at.rows.forEach((rows, cell) => {
    const v = values[cell];
    if (!rows || v === undefined) return;
    const [i, j, failing] = [Math.floor(cell / down), cell % down, at.bad[cell]];
    const [cx, cy] = [x.at(i), y.at(j + 1)];
    const node = rect(cx, cy, 1, { rx: 3, fill: v === null ? "var(--soft)" : css(paint(v)) });
    if (failing && !shares) rect(cx, cy, 3, { rx: 2, class: "fails" });
    const words = shares ? `${number(v)} %` : number(v);
    const text = `${failing && !shares ? "× " : ""}${words}`;
    const mean = shares ? "" : `mean ${called(metric)} ${v === null ? words : withUnit(words, metric)}, `;
    draw(node, "title", {}, `${first} ${at.names[0][i]}, ${second} ${at.names[1][j]}: ${mean}${failing} of ${rows} rows without success`);
    if (x.size <= 8 * text.length || y.size <= 18) return;
    const ink = isLight(v === null ? GREY : paint(v)) ? "on-light" : "on-dark";
    draw(plot, "text", { x: cx + x.size / 2, y: cy + y.size / 2 + 4, "text-anchor": "middle", class: ink }, text);
  });
}

/** Means of a metric over the drawn rows of each cell; null where none has it, undefined without rows. */
function means({ keys: [first, second], names, rows }: Cells, metric: string): (number | null | undefined)[] {
  const x = keyAxis(first, 0, 1);
  const y = keyAxis(second, 0, 1);
  const groups: (number | null)[][] = rows.map(() => []);
  data.points[metric].forEach((v, row) => groups[x.place(data.points[first][row]!) * names[1].length + y.place(data.points[second][row]!)].push(v));
  return groups.map((group) => {
    const numbers = known(group);
    if (!group.length) return undefined;
    return numbers.length ? numbers.reduce((a, b) => a + b, 0) / numbers.length : null;
  });
}
