// A metric over a key, row by row; of success, the share of rows without it.
import { draw, make } from "../dom.ts";
import { canvas, frame, height, keyAxis, level, scale, wide } from "./axes.ts";
import { data, drawingOrder, FAILURES, hasFailures, isMargin, known, number, state, title } from "./data.ts";
import { colours, crosses, mark } from "./marks.ts";

export function chart(into: HTMLElement, legendInto: HTMLElement, hint: HTMLElement): void {
  hint.hidden = state.metric === FAILURES;
  if (state.metric === FAILURES) bars(into, state.key);
  else points(into, state.metric, state.key);
  legendInto.replaceChildren(...(state.metric === FAILURES ? [] : legend(state.colour)));
}

function points(into: HTMLElement, metric: string, key: string): void {
  const values = data.points[metric];
  const xs = data.points[key] as number[];
  const numbers = known(values);
  const lost = values.length > numbers.length;
  const count = values.length;
  const usual = data.nominal[metric];
  const said = `${title(metric)} of ${count} rows over ${title(key)}: ${number(Math.min(...numbers))} to ${number(Math.max(...numbers))}`;
  const [plot, box] = canvas(into, height(), `${said}; ${data.bad.filter(Boolean).length} rows without success`);
  const y = scale(values, box.bottom - (lost ? 26 : 0), box.top, [...(isMargin(metric) ? [0] : []), ...(usual === undefined ? [] : [usual])]);
  box.left = 14 + wide(y.ticks.map(([text]) => text));
  const x = keyAxis(key, box.left, box.right);
  frame(plot, box, x, y.ticks, [title(key), title(metric) + (y.bent ? ", logarithmic away from 0" : "")]);
  if (isMargin(metric)) level(plot, box, y.at(0), "bound");
  if (usual !== undefined) {
    level(plot, box, y.at(usual), "usual");
    draw(plot, "text", { x: box.right, y: y.at(usual) - 5, "text-anchor": "end" }, "unvaried");
  }
  if (lost) draw(plot, "text", { x: box.left - 8, y: box.bottom - 6, "text-anchor": "end" }, "none");
  const fill = state.colour ? colours(state.colour) : null;
  const paint = (row: number) => fill?.(data.points[state.colour][row]!) ?? "var(--accent)";
  const at = (row: number) => [x.at(xs[row]), values[row] === null ? box.bottom - 10 : y.at(values[row])] as const;
  if (data.isGrid && x.size) for (const line of lines(key, values)) {
    draw(plot, "path", { d: line.map((row, i) => `${i ? "L" : "M"}${at(row).join(" ")}`).join(""), class: "curve", stroke: paint(line[0]) });
  }
  const size = count > 1000 ? 2.5 : count > 200 ? 3.5 : 5;
  for (const row of drawingOrder) mark(plot, row, ...at(row), size, data.bad[row] ? "" : paint(row));
}

/** Rows that differ in a key alone, in its order: the curves of a grid. */
function lines(key: string, values: readonly (number | null)[]): number[][] {
  const groups = new Map<string, number[]>();
  const others = data.keys.filter((each) => each !== key);
  for (const row of values.keys()) {
    if (values[row] === null) continue;
    const group = JSON.stringify(others.map((each) => data.points[each][row]));
    groups.set(group, [...(groups.get(group) ?? []), row]);
  }
  const xs = data.points[key] as number[];
  return groups.size > 60 ? [] : [...groups.values()].map((rows) => rows.sort((a, b) => xs[a] - xs[b]));
}

function legend(key: string): HTMLElement[] {
  const chips = key ? [make("span", "", `${title(key)}:`), ...keyChips(key)] : [];
  return [...chips, ...(hasFailures ? [crosses()] : [])];
}

/** A chip for each of a few values, or for the least and the greatest. */
function keyChips(key: string): HTMLElement[] {
  const { each, names, starts, ends } = data.marginals[key];
  const paint = colours(key);
  const last = names.length - 1;
  const chosen = each && last < 12 ? [...names.keys()] : [0, last];
  return chosen.map((i) => {
    const v = each ? (starts[i] + ends[i]) / 2 : i ? ends[i] : starts[0];
    const chip = make("i");
    chip.style.background = paint(v);
    return make("span", "chip", chip, each ? names[i] : number(v));
  });
}

/** The share of rows without success by value, of all rows. */
function bars(into: HTMLElement, key: string): void {
  const { bad, rows, names, starts, ends, bounds: pairs } = data.marginals[key];
  const failing = bad.reduce((a, b) => a + b, 0);
  const [plot, box] = canvas(into, height(), `Share of rows without success over ${title(key)}: ${failing} of ${data.total} rows`);
  const shares = rows.map((n, i) => (n ? (100 * bad[i]) / n : 0));
  const bounds = pairs.map(([low, high]) => [100 * low, 100 * high]);
  const highest = Math.max(1, ...shares, ...bounds.filter((_, i) => rows[i]).map(([, high]) => high));
  const y = scale([0, highest], box.bottom, box.top);
  const ticks = y.ticks.map(([text, place]): [string, number] => [`${text} %`, place]);
  box.left = 14 + wide(ticks.map(([text]) => text));
  const x = keyAxis(key, box.left, box.right);
  frame(plot, box, x, ticks, [title(key), title(FAILURES)]);
  rows.forEach((n, i) => {
    if (!n) return;
    const middle = x.size ? x.ticks[i][1] : 0;
    const [a, b] = x.size ? [middle - 0.4 * x.size, middle + 0.4 * x.size] : [x.at(starts[i]) + 0.5, x.at(ends[i]) - 0.5];
    const top = y.at(shares[i]);
    const bar = draw(plot, "rect", { x: a, y: top, width: Math.max(b - a, 1), height: box.bottom - top, class: "bar" });
    draw(bar, "title", {}, `${names[i]}: ${bad[i]} of ${n} without success`);
    if (bounds.length) draw(plot, "line", { x1: (a + b) / 2, x2: (a + b) / 2, y1: y.at(bounds[i][0]), y2: y.at(bounds[i][1]), class: "range" });
  });
}
