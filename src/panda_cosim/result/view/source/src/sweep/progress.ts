// A search, row by row.
import { draw } from "../dom.ts";
import { canvas, frame, level, scale, steps, wide } from "./axes.ts";
import { called, data } from "./data.ts";

const HEIGHT = 280; // [px]

/** The smallest margin up to each row, or the largest; -Infinity stands for none. */
export function bestSoFar(margin: readonly (number | null)[]): (number | null)[] {
  let best: number | null = null;
  return margin.map((v) => {
    const now = v ?? -Infinity;
    if (best === null || (data.search === "fail" ? now < best : now > best)) best = now;
    return Number.isFinite(best) ? best : null;
  });
}

export function progress(into: HTMLElement): void {
  const { index, searched: name } = data;
  const margin = data.points[name];
  const [plot, box] = canvas(into, HEIGHT, `${called(name)} by row, and the best so far`);
  const y = scale(margin, box.bottom, box.top, [0]);
  box.left = 14 + wide(y.ticks.map(([text]) => text));
  const last = Math.max(index[index.length - 1], 1);
  const x = (v: number) => box.left + 6 + (v / last) * (box.right - box.left - 12);
  const below = steps(0, last, 8).map((v): [string, number] => [String(v), x(v)]);
  frame(plot, box, { ticks: below }, y.ticks, ["row", `${called(name)}; line: best so far`]);
  level(plot, box, y.at(0), "bound");
  margin.forEach((v, i) => v !== null && draw(plot, "circle", { cx: x(index[i]), cy: y.at(v), r: 3, fill: v < 0 ? "var(--bad)" : "var(--accent)" }));
  const places = bestSoFar(margin).flatMap((v, i) => (v === null ? [] : [`${x(index[i])} ${y.at(v)}`]));
  draw(plot, "path", { d: `M${places.join("L")}`, class: "curve", stroke: "var(--ink)" });
}
