// Scales, and the axes around a plot.
import { draw } from "../dom.ts";
import { data, ends, fit, isSame, known, number } from "./data.ts";

export type Tick = [text: string, place: number];

/** Places of numbers along a line [px]. */
interface Scale {
  at(v: number): number;
  ticks: Tick[];
  bent: boolean; // logarithmic on both sides of 0
}

/** Places of a key's values along a line [px]. */
interface KeyAxis {
  at(v: number): number;
  ticks: Tick[];
  size: number; // of the place of one value; 0: its values are a range
  parts: number;
  place(v: number): number; // number of a value's place
}

/** What a plot stands in [px]. */
export interface Box {
  left: number;
  right: number;
  top: number;
  bottom: number;
}

const TOP = 30;
const BELOW = 48;

export const wide = (texts: readonly string[]): number => 7 * Math.max(...texts.map((text) => text.length));
export const height = (): number => (window.innerWidth < 700 ? 320 : 420);

/** Round numbers from low to high, about `count` of them, but never one alone. */
export function steps(low: number, high: number, count: number): number[] {
  const rough = (high - low) / Math.max(count, 5);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= rough * 0.999)!;
  const places = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const ticks = [];
  for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + 1e-9 * step; v += step) ticks.push(+v.toFixed(Math.min(places, 12)));
  return ticks;
}

/** A scale of values: linear or, if few are far away from the others, logarithmic on both sides of 0. */
export function scale(values: readonly (number | null)[], from: number, to: number, includes: readonly number[] = []): Scale {
  const all = known([...values, ...includes]);
  let [low, high] = all.length ? ends(all) : [0, 1];
  if (isSame(low, high)) [low, high] = [low - (Math.abs(low) / 10 || 0.5), high + (Math.abs(high) / 10 || 0.5)];
  else if (low > 0 && low < high / 2) low = 0;
  const sizes = known(values).map(Math.abs).sort((a, b) => a - b);
  const middle = sizes[sizes.length >> 1] ?? 0;
  const bent = middle > 0 && Math.max(-low, high) > 40 * middle;
  const bend = bent ? (v: number) => Math.asinh(v / middle) : (v: number) => v;
  const pad = 0.04 * (bend(high) - bend(low));
  const first = bend(low) - (low === 0 ? 0 : pad);
  const last = bend(high) + pad;
  const at = (v: number) => from + ((bend(v) - first) / (last - first)) * (to - from);
  const ticks = bent ? powers(low, high, middle, at) : steps(low, high, Math.abs(to - from) / 70);
  return { at, ticks: ticks.map((v) => [number(v), at(v)]), bent };
}

/** 0 and powers of 10 on both sides of it, as many as have room. */
function powers(low: number, high: number, middle: number, at: (v: number) => number): number[] {
  const ticks = [0];
  for (let i = 0; i < 13; i++) {
    const power = 10 ** (Math.floor(Math.log10(middle)) + i);
    for (const tick of [power, -power]) {
      if (tick >= low && tick <= high && ticks.every((other) => Math.abs(at(other) - at(tick)) > 22)) ticks.push(tick);
    }
  }
  return ticks;
}

/** The axis of a varied key: its values at equal distances if it has few, else its range. */
export function keyAxis(key: string, from: number, to: number): KeyAxis {
  const { each, names, starts, ends: tops } = data.marginals[key];
  const parts = names.length;
  const middles = starts.map((start, i) => (start + tops[i]) / 2);
  const place = (v: number) => middles.reduce((best, m, i) => (Math.abs(m - v) < Math.abs(middles[best] - v) ? i : best), 0);
  if (each) {
    const size = (to - from) / parts;
    const middle = (i: number) => from + (i + 0.5) * size;
    return { parts, place, size: Math.abs(size), at: (v) => middle(place(v)), ticks: names.map((name, i) => [name, middle(i)]) };
  }
  const [low, high] = [starts[0], tops[parts - 1]];
  const pad = (to - from) * 0.015;
  const at = (v: number) => from + pad + ((v - low) / (high - low)) * (to - from - 2 * pad);
  return { parts, place, size: 0, at, ticks: steps(low, high, Math.abs(to - from) / 110).map((v) => [number(v), at(v)]) };
}

/** Start a plot that fills an element's width, without scaling, so that text has its usual size. */
export function canvas(into: HTMLElement, high: number, label: string): [SVGSVGElement, Box] {
  const width = Math.max(into.clientWidth, 260);
  into.replaceChildren();
  const plot = draw(into, "svg", { viewBox: `0 0 ${width} ${high}`, width, height: high, role: "img", "aria-label": label });
  return [plot, { left: 0, right: width - 10, top: TOP, bottom: high - BELOW }];
}

/** Draw a horizontal line across a plot. */
export function level(plot: SVGElement, { left, right }: Box, y: number, kind: string): void {
  draw(plot, "line", { x1: left, x2: right, y1: y, y2: y, class: kind });
}

/** Write the axes around a plot: ticks below, and beside with grid lines. */
export function frame(plot: SVGElement, box: Box, below: { ticks: Tick[]; size?: number }, beside: readonly Tick[], names: [string, string]): void {
  const { left, right, bottom } = box;
  for (const [text, y] of beside) {
    level(plot, box, y, "grid");
    draw(plot, "text", { x: left - 8, y: y + 4, "text-anchor": "end" }, text);
  }
  let end = -Infinity;
  const most = below.size ? Math.max(Math.floor(below.size / 7), 12) : 20;
  for (const [name, place] of [...below.ticks].sort((a, b) => a[1] - b[1])) {
    const text = fit(name, most);
    const half = 3.4 * text.length;
    if (place - half < end) continue;
    end = place + half + 8;
    const centre = Math.min(Math.max(place, half + 2), Math.max(right + 8 - half, half + 2));
    const written = draw(plot, "text", { x: centre, y: bottom + 18, "text-anchor": "middle" }, text);
    if (text !== name) draw(written, "title", {}, name);
    draw(plot, "line", { x1: place, x2: place, y1: bottom, y2: bottom + 4, class: "axis" });
  }
  level(plot, box, bottom, "axis");
  draw(plot, "text", { x: (left + right) / 2, y: bottom + 40, "text-anchor": "middle", class: "name" }, fit(names[0], Math.floor((right - left) / 7.5)));
  draw(plot, "text", { x: 2, y: 13, class: "name" }, fit(names[1], Math.floor(right / 7.5)));
}
