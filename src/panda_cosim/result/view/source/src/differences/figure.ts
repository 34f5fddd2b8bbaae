// One figure, drawn by uPlot: the curves of a column in all runs, and below them the differences.
import uPlot from "uplot";
import { button, make } from "../dom.ts";
import { listen } from "../keys.ts";
import { axes, gap, hearTouch, write } from "../plot.ts";
import type { Curve } from "./curve.ts";
import { editor } from "./edit.ts";

const HEIGHTS = [186, 104]; // of the two plots [px]
const BESIDE = 62; // [px]
const COLOURS = 5; // of runs
const DIGITS = 7; // of float32
let figures = 0;
type Line = { values: ArrayLike<number>; colour: string };

export class Figure {
  readonly plots: uPlot[];
  private readonly read = make("span", "read");
  private readonly key = `figure-${figures++}`; // both plots share their cursor
  private view: readonly [number, number];

  constructor(private readonly host: HTMLElement, readonly curve: Curve) {
    const { runs, baseline, unit } = curve;
    this.view = curve.span;
    const colours = runs.map((_, index) => `--curve-${(index % COLOURS) + 1}`);
    const zero = new Float32Array(baseline.length);
    host.replaceChildren();
    this.plots = [
      this.plot(unit, baseline, runs.map(({ values }, i) => ({ values, colour: colours[i] }))),
      this.plot(unit ? `difference, ${unit}` : "difference", zero, runs.map(({ differences: values }, i) => ({ values, colour: colours[i] }))),
    ];
    host.append(make("div", "tools", ...this.tools(), this.read));
    const name = host.closest("figure")?.querySelector("figcaption b")?.textContent ?? "";
    if (curve.tube.length) host.append(editor(curve, name, (tolerance) => this.widen(tolerance)));
    this.listen();
    this.look(...curve.span);
  }

  /** Draw in the page's present colours. */
  redraw(): void {
    for (const plot of this.plots) plot.redraw(false, true);
  }

  /** Draw the tube with another half-width. */
  private widen(tolerance: number): void {
    const { curve } = this;
    const by = [-1, 1].map((side) => side * (tolerance - (curve.tolerance ?? 0)));
    const origins = [curve.baseline, new Float32Array(curve.baseline.length)];
    this.plots.forEach((plot, index) => {
      const edges = curve.tube.map((edge, side) => Array.from(edge, (value, row) => gap(value + by[side] + origins[index][row])));
      const [time, , , ...lines] = plot.data;
      plot.setData([time, ...edges, ...lines] as uPlot.AlignedData, false);
      plot.redraw(true, true);
    });
  }

  private tools(): HTMLElement[] {
    const { worst, span: [begin, end] } = this.curve;
    const near = Math.max(0.02, (end - begin) / 60);
    return [
      button("Zoom in", "", () => this.scale(0.5), "+"),
      button("Zoom out", "", () => this.scale(2), "−"),
      button("Zoom to the worst deviation", "", () => this.look(worst - near, worst + near), "Worst"),
      button("Show all", "", () => this.look(begin, end), "All"),
    ];
  }

  private listen(): void {
    const { host } = this;
    const key = (name: string, words: string, act: () => void) => ({ keys: [name], words, act });
    listen([
      key("+", "zoom in", () => this.scale(0.5)),
      key("-", "zoom out", () => this.scale(2)),
      key("0", "show all", () => this.look(...this.curve.span)),
      key("ArrowLeft", "earlier", () => this.shift(-0.2)),
      key("ArrowRight", "later", () => this.shift(0.2)),
    ], host);
    host.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return;
      event.preventDefault();
      const left = event.clientX - this.plots[0].over.getBoundingClientRect().left;
      this.scale(event.deltaY < 0 ? 0.7 : 1 / 0.7, this.plots[0].posToVal(left, "x"));
    }, { passive: false });
    new ResizeObserver(() => this.plots.forEach((plot, index) => {
      if (host.clientWidth) plot.setSize({ width: host.clientWidth, height: HEIGHTS[index] });
    })).observe(host);
  }

  /** Show a span of time [s], within that of the curve, and not less than four rows. */
  private look(from: number, to: number): void {
    const { span: [begin, end], step } = this.curve;
    const middle = (from + to) / 2;
    const length = Math.min(Math.max(to - from, 4 * step), end - begin);
    const first = Math.min(Math.max(to - from < length ? middle - length / 2 : from, begin), end - length);
    this.view = [first, first + length];
    for (const plot of this.plots) plot.setScale("x", { min: first, max: first + length });
    [this.host.dataset.from, this.host.dataset.to] = this.view.map(String);
  }

  private scale(factor: number, about = (this.view[0] + this.view[1]) / 2): void {
    const [from, to] = this.view;
    this.look(about - (about - from) * factor, about + (to - about) * factor);
  }

  private shift(share: number): void {
    const [from, to] = this.view;
    this.look(from + (to - from) * share, to + (to - from) * share);
  }

  /** The plot above, or the one below, whose curves are differences from zero. */
  private plot(words: string, origin: Float32Array, runs: readonly Line[]): uPlot {
    const { curve, host } = this;
    const isBelow = runs[0].values === curve.runs[0].differences;
    const colour = (name: string) => () => getComputedStyle(host).getPropertyValue(name);
    const tube = curve.tube.map((edge) => edge.map((value, row) => value + origin[row]));
    const lines: Line[] = [{ values: origin, colour: "--curve-0" }, ...runs];
    const [below, beside] = axes(colour("--muted"), colour("--grid"), BESIDE, "s");
    const plot = new uPlot({
      width: host.clientWidth,
      height: HEIGHTS[isBelow ? 1 : 0],
      padding: [8, 8, isBelow ? 0 : 8, 0],
      legend: { show: false },
      scales: { x: { time: false, auto: false }, y: { range: (_, low, high) => this.range(low, high, isBelow) } },
      series: [
        {},
        ...tube.map(() => ({ auto: false, width: 0, points: { show: false } })),
        ...lines.map((line) => ({ stroke: colour(line.colour), width: 1.5, points: { show: false } })),
      ],
      bands: tube.length ? [{ series: [2, 1], fill: colour("--tube") }] : [],
      cursor: { sync: { key: this.key }, drag: { x: true, y: false }, points: { show: false }, y: false },
      axes: [{ ...below, show: isBelow, grid: { show: false } }, { ...beside, space: isBelow ? 20 : 30 }],
      hooks: {
        setScale: [(drawn, key) => this.zoomed(drawn, key)],
        setCursor: [({ cursor: { idx } }) => this.readAt(idx ?? null)],
        draw: [(drawn) => this.mark(drawn, words)],
      },
    }, [curve.time, ...[...tube, ...lines.map(({ values }) => values)].map((values) => Array.from(values, gap))] as uPlot.AlignedData, host);
    hearTouch(plot);
    return plot;
  }

  /** The range of values to draw, without the tube; the bounds of a difference are in it. */
  private range(least: number | null, greatest: number | null, isBelow: boolean): [number, number] {
    const bounds = isBelow ? [this.curve.tolerance ?? 0, -(this.curve.tolerance ?? 0)] : [];
    const known = [least, greatest, ...bounds].filter((value) => value !== null);
    const [low, high] = known.length ? [Math.min(...known), Math.max(...known)] : [-1, 1];
    const pad = (high - low) * 0.06 || Math.abs(high) * 0.01 || (this.curve.tolerance ?? 0.5) * 2;
    return [low - pad, high + pad];
  }

  private zoomed({ scales: { x } }: uPlot, key: string): void {
    if (key === "x" && this.plots && (x.min !== this.view[0] || x.max !== this.view[1])) this.look(x.min!, x.max!);
  }

  /** Say what the curves are at a row. */
  private readAt(row: number | null): void {
    const { curve: { time, name, baseline, runs }, read } = this;
    const short = (value: number) => (Number.isFinite(value) ? String(Number(value.toPrecision(DIGITS))) : "none");
    read.textContent = row === null ? "" : [
      `${time[row].toFixed(3)} s: ${runs.map((run) => `${run.name} ${short(run.values[row])} (difference ${apart(run.differences[row])})`).join(", ")}`,
      `${name} ${short(baseline[row])}`,
    ].join(", ");
  }

  /** Mark gaps and the worst instant, and write what is drawn. */
  private mark(plot: uPlot, words: string): void {
    const { ctx, bbox: { left, top, width, height } } = plot;
    const { time, gaps, worst } = this.curve;
    const ink = getComputedStyle(this.host);
    const x = (at: number) => plot.valToPos(at, "x", true);
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.strokeStyle = ink.getPropertyValue("--line");
    ctx.lineWidth = uPlot.pxRatio;
    ctx.stroke();
    ctx.clip();
    ctx.fillStyle = ctx.strokeStyle = ink.getPropertyValue("--bad");
    ctx.globalAlpha = 0.22;
    for (const [first, last] of gaps) {
      const from = x(time[Math.max(first - 1, 0)]);
      const to = x(time[Math.min(last + 1, time.length - 1)]);
      ctx.fillRect(from, top, Math.max(to - from, 3 * uPlot.pxRatio), height);
    }
    ctx.globalAlpha = 1;
    ctx.setLineDash([2 * uPlot.pxRatio, 3 * uPlot.pxRatio]);
    ctx.beginPath();
    ctx.moveTo(x(worst), top);
    ctx.lineTo(x(worst), top + height);
    ctx.stroke();
    ctx.restore();
    write(plot, words, ink.getPropertyValue("--muted"));
  }
}

const apart = (value: number): string => (Number.isFinite(value) ? value.toPrecision(3) : "none");
