// Marks of rows, and their colours.
import { css, PALETTE, shade } from "../colours.ts";
import { draw, make } from "../dom.ts";
import { keyAxis } from "./axes.ts";
import { data, facts, state } from "./data.ts";

export const dark = matchMedia("(prefers-color-scheme: dark)");

/** The colours of a key's values, on the page's own ground. */
export function colours(key: string): (v: number) => string {
  const { each, starts, ends } = data.marginals[key];
  const { place, parts } = keyAxis(key, 0, 1);
  const seen = (share: number) => css(shade(dark.matches ? 0.25 + 0.75 * share : 0.85 * share));
  if (each && data.labels[key]) return (v) => PALETTE[place(v) % PALETTE.length];
  if (each) return (v) => seen(place(v) / Math.max(parts - 1, 1));
  return (v) => seen((v - starts[0]) / (ends[parts - 1] - starts[0]));
}

/** Mark a row: a disc, and a cross without success, on a disc if it has a colour. */
export function mark(plot: SVGElement, row: number, x: number, y: number, size: number, fill: string): void {
  const s = size * 0.9;
  const bad = data.bad[row];
  if (bad && fill) draw(plot, "circle", { cx: x, cy: y, r: size, fill });
  const node = bad
    ? draw(plot, "path", { d: `M${x - s} ${y - s}l${2 * s} ${2 * s}m0 ${-2 * s}l${-2 * s} ${2 * s}`, class: "cross", "data-row": row })
    : draw(plot, "circle", { cx: x, cy: y, r: size, fill, class: "dot", "data-row": row });
  if (row === state.row) draw(plot, "circle", { cx: x, cy: y, r: size + 5, class: "chosen" });
  draw(node, "title", {}, facts(row).join("\n"));
}

/** The words of a legend that explain the crosses. */
export const crosses = (): HTMLElement => make("span", "chip fails", "× without success");
