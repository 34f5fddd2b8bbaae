// One chart, drawn by uPlot: curves of a run and of its ghost, linked to the clock.
import uPlot from "uplot";
import { rowAt } from "../data/lookup.ts";
import type { RunSource, Series } from "../data/source.ts";
import type { Clock } from "../clock.ts";
import { PALETTE } from "../colours.ts";
import { button, hint, icon, legible, make, number } from "../dom.ts";
import { axes, gap, hearTouch, write } from "../plot.ts";

const HEIGHT = 132; // [px]
const CROSS = "M6 6l12 12M18 6L6 18";

interface Curve {
  column: string;
  colour: string;
  own: Series;
  other: Series | null;
  reading: HTMLElement;
}

export interface ChartLinks {
  clock: Clock;
  run: RunSource;
  ghost: RunSource | null;
  zoomed(chart: Chart, low: number, high: number): void;
  removed(chart: Chart): void;
}

export class Chart {
  readonly element: HTMLElement;
  private plot: uPlot | null = null;
  private readonly plotPlace = make("div", "pv-plot");
  private readonly needle = make("div", "pv-needle");
  private readonly unit: string;
  private curves: Curve[] = [];
  private zooming = false;

  constructor(
    readonly title: string,
    readonly columns: readonly string[],
    private readonly links: ChartLinks,
  ) {
    this.unit = links.run.unit(columns[0]);
    const head = make("h3", "", make("bdi", "", title), make("span", "pv-unit", this.shownUnit));
    const close = button(`Remove ${title}`, "pv-close", () => links.removed(this), icon(CROSS));
    this.element = make("section", "pv-chart", make("div", "pv-chart-head", head, close), this.plotPlace);
    this.element.dataset.title = title;
    this.plotPlace.tabIndex = 0;
    this.plotPlace.setAttribute("role", "img");
    this.plotPlace.setAttribute("aria-label", legible(title));
    this.plotPlace.addEventListener("focus", () => this.name());
    this.plotPlace.addEventListener("keydown", (event) => {
      if (!["+", "-", "0"].includes(event.key)) return; // others move the time
      event.stopPropagation();
      this.zoomed(event);
    });
  }

  private get shownUnit(): string {
    return this.unit === "1" ? "" : legible(this.unit);
  }

  /** Decode the curves and draw them. */
  async open(): Promise<void> {
    const { run, ghost } = this.links;
    this.curves = await Promise.all(this.columns.map((column, index) => this.curve(column, index, run, ghost)));
    const { links } = this;
    const names = this.curves.map(({ column, colour, reading }) => {
      const chip = make("span", "pv-chip");
      chip.style.background = colour;
      const text = this.columns.length > 1 ? element(column, links.run.unit(column)) : column;
      const name = make("span", "pv-name", chip, make("span", "", text), reading);
      hint(name, column);
      return name;
    });
    this.element.append(make("div", "pv-legend", ...names));
    this.draw();
    this.show(this.links.clock.time);
  }

  /** Move the time cursor and the readings to an instant. */
  show(time: number): void {
    if (!this.plot) return;
    const x = this.plot.valToPos(time, "x");
    this.needle.style.transform = `translateX(${x.toFixed(1)}px)`;
    this.needle.hidden = !(x >= 0 && x <= this.plot.over.clientWidth);
    for (const { own, reading } of this.curves) {
      reading.textContent = number(own.values[rowAt(own.time, time)], this.unit);
    }
    if (document.activeElement === this.plotPlace) this.name();
  }

  /** Say the curves and their values, for those who hear the page. */
  private name(): void {
    const readings = this.curves.map(({ column, reading }) => `${column} ${reading.textContent}`).join(", ");
    const unit = this.shownUnit && ` in ${this.shownUnit}`;
    this.plotPlace.setAttribute("aria-label", legible(`${this.title}${unit} at ${this.links.clock.time.toFixed(3)} s: ${readings}`));
  }

  /** Zoom in or out about the present, or show all. */
  private zoomed(event: KeyboardEvent): void {
    const { clock } = this.links;
    const { min, max } = this.plot!.scales.x;
    const half = ((max! - min!) / 2) * (event.key === "+" ? 0.5 : 2);
    const [begin, end] = clock.span;
    const whole = event.key === "0" || 2 * half >= end - begin;
    const [low, high] = whole ? [begin, end] : [clock.time - half, clock.time + half];
    this.zoom(low, high);
    this.links.zoomed(this, low, high);
  }

  /** Show a time range [s]. */
  zoom(low: number, high: number): void {
    this.zooming = true;
    this.plot?.setScale("x", { min: low, max: high });
    this.zooming = false;
    this.show(this.links.clock.time);
  }

  /** Read the grown curves again and redraw them. */
  async grow(): Promise<void> {
    const { run } = this.links;
    for (const curve of this.curves) curve.own = await run.series(curve.column);
    this.zooming = true;
    this.plot?.setData(this.data());
    this.zooming = false;
    this.show(this.links.clock.time);
  }

  /** Fit the available width. */
  resize(): void {
    const width = this.plotPlace.clientWidth;
    if (this.plot && width && width !== this.plot.width) {
      this.plot.setSize({ width, height: HEIGHT });
      this.show(this.links.clock.time);
    }
  }

  /** Redraw in the page's current colours. */
  draw(): void {
    const range = this.plot ? [this.plot.scales.x.min!, this.plot.scales.x.max!] : null;
    this.plot?.destroy();
    this.plotPlace.replaceChildren();
    this.plot = new uPlot(this.options(), this.data(), this.plotPlace);
    hearTouch(this.plot);
    this.plot.over.append(this.needle);
    this.plot.over.addEventListener("click", (event) => this.clicked(event));
    if (range) this.zoom(range[0], range[1]);
  }

  dispose(): void {
    this.plot?.destroy();
    this.plot = null;
    this.element.remove();
  }

  private async curve(column: string, index: number, run: RunSource, ghost: RunSource | null): Promise<Curve> {
    const own = await run.series(column);
    const other = ghost ? await ghost.series(column).catch(() => null) : null;
    return { column, colour: PALETTE[index % PALETTE.length], own, other, reading: make("output", "pv-reading") };
  }

  private options(): uPlot.Options {
    const ink = (name: string) => () => getComputedStyle(this.element).getPropertyValue(name);
    const own = this.curves.map(({ column, colour }) => ({ label: column, stroke: colour, width: 1.5, points: { show: false } }));
    const other = this.curves
      .filter(({ other }) => other)
      .map(({ column, colour }) => ({ label: column, stroke: colour, width: 1.5, alpha: 0.75, dash: [6, 4], points: { show: false } }));
    return {
      width: this.plotPlace.clientWidth || 360,
      height: HEIGHT,
      padding: [8, 8, 0, 0],
      legend: { show: false },
      scales: { x: { time: false, range: ({ data: [times] }, low, high) => (times.length > 1 ? [low, high] : [times[0], times[0] + 1]) } }, // 1 s before a run begins
      series: [{}, ...own, ...other],
      cursor: { sync: { key: "panda-view" }, drag: { x: true, y: false }, points: { size: 6 } },
      axes: axes(ink("--muted"), ink("--grid"), 48, "s"),
      hooks: { setScale: [(plot, key) => this.scaled(plot, key)], draw: [(plot) => this.drawBounds(plot), (plot) => write(plot, this.shownUnit, ink("--muted")())] },
    };
  }

  /** Return uPlot's columns, all over the run's time; a ghost's curve is resampled to it. */
  private data(): uPlot.AlignedData {
    const { time } = this.curves[0].own;
    const onTime = (series: Series) =>
      series.time === time
        ? Array.from(series.values, gap)
        : Array.from(time, (at) => (at > series.time[series.time.length - 1] + 1e-9 ? null : gap(series.values[rowAt(series.time, at + 1e-9)])));
    const own = this.curves.map((curve) => onTime(curve.own));
    const other = this.curves.flatMap((curve) => (curve.other ? [onTime(curve.other)] : []));
    return [Array.from(time), ...own, ...other] as uPlot.AlignedData;
  }

  private clicked(event: MouseEvent): void {
    const { plot } = this;
    if (!plot || plot.select.width > 2) return; // the end of a zoom
    this.links.clock.seek(plot.posToVal(event.clientX - plot.over.getBoundingClientRect().left, "x"));
  }

  private scaled(plot: uPlot, key: string): void {
    if (key !== "x" || this.zooming || !this.plot) return;
    this.links.zoomed(this, plot.scales.x.min!, plot.scales.x.max!);
    this.show(this.links.clock.time);
  }

  /** Draw the limits within the visible range: red if all curves share them, else in each curve's colour. */
  private drawBounds(plot: uPlot): void {
    const { ctx, bbox } = plot;
    const { min, max } = plot.scales.y;
    ctx.save();
    ctx.setLineDash([2 * devicePixelRatio, 3 * devicePixelRatio]);
    ctx.lineWidth = 1.5 * devicePixelRatio;
    for (const [level, colour] of this.boundLevels()) {
      if (min == null || max == null || level < min || level > max) continue;
      const y = plot.valToPos(level, "y", true);
      ctx.strokeStyle = colour;
      ctx.beginPath();
      ctx.moveTo(bbox.left, y);
      ctx.lineTo(bbox.left + bbox.width, y);
      ctx.stroke();
    }
    ctx.restore();
  }

  /** Return the limits with their colours; red if all curves share them. */
  private boundLevels(): Map<number, string> {
    const all = this.curves.map(({ column, colour }) => ({ colour, pair: this.links.run.bounds(column) }));
    const shared = new Set(all.map(({ pair }) => pair?.join() ?? "")).size === 1;
    const red = getComputedStyle(this.element).getPropertyValue("--bad");
    const levels = new Map<number, string>();
    for (const { colour, pair } of all)
      for (const level of pair ?? []) if (!levels.has(level)) levels.set(level, shared ? red : colour);
    return levels;
  }
}

/** Name an element of a signal: a joint, an axis, or its index. */
function element(column: string, unit: string): string {
  const [, signal, index] = /^(.*)\[(\d+)\]$/.exec(column) ?? [];
  if (!index) return column;
  if (/^(m|m\/s|N)$/.test(unit) && /(pos|vel|force|linear)/.test(signal) && Number(index) <= 3 && !/q(pos|vel)|actuator/.test(signal)) return "xyz"[Number(index) - 1];
  return /(qpos|qvel|dq|ctrl|actuator_force|qfrc_\w+|torque|kp|ki|kd)(_ref)?$/.test(signal) && /^(rad|rad\/s|N\.m)$/.test(unit) ? `joint ${index}` : `[${index}]`;
}
