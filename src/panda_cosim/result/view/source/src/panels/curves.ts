// All charts, one below the other, linked in time and zoom, with a search field to add more.
import type { Clock } from "../clock.ts";
import type { RunSource } from "../data/source.ts";
import { make } from "../dom.ts";
import { Chart, type ChartLinks } from "./chart.ts";
import { Picker } from "./picker.ts";

const MOST = 8; // curves in one chart, when a whole signal is added
const FIRST = 6; // signals that are drawn where the run comes with no curves
const INTERVAL = 120; // [ms] between two updates of growing curves

export class Curves {
  readonly element = make("div", "pv-curves");
  private readonly list = make("div", "pv-charts");
  private charts: Chart[] = [];
  private waiting = 0;
  private readonly links: ChartLinks;

  constructor(
    private readonly run: RunSource,
    ghost: RunSource | null,
    clock: Clock,
  ) {
    this.links = {
      clock,
      run,
      ghost,
      zoomed: (origin, low, high) => this.charts.forEach((chart) => chart !== origin && chart.zoom(low, high)),
      removed: (chart) => this.remove(chart),
    };
    const search = new Picker(run.signals, (title, columns) => void this.add(title, columns, true));
    const hint = make("p", "pv-hint", "Click: go to that time. Drag: zoom in. Double-click: show all.");
    this.element.append(search.element, this.list, hint);
    clock.onTime((time) => this.charts.forEach((chart) => chart.show(time)));
    new ResizeObserver(() => this.charts.forEach((chart) => chart.resize())).observe(this.list);
  }

  /** Draw the curves that the run comes with. */
  async open(): Promise<void> {
    const extra = this.run.signals.filter(({ name }) => name === "distance to the other run");
    for (const { name } of extra) await this.add("Distance to the other run", [name]);
    const { curves } = this.run.about;
    const first = this.run.signals.slice(0, FIRST).map(({ name: title, columns }) => ({ title, columns }));
    for (const { title, columns } of curves.length ? curves : first) await this.add(title, columns);
  }

  /** Add a chart below the others, or on top and scrolled into view. */
  async add(title: string, columns: readonly string[], onTop = false): Promise<void> {
    const chart = new Chart(title, columns.slice(0, MOST), this.links);
    if (onTop) this.charts.unshift(chart);
    else this.charts.push(chart);
    if (onTop) this.list.prepend(chart.element);
    else this.list.append(chart.element);
    await chart.open();
    if (onTop) chart.element.scrollIntoView({ block: "nearest" });
  }

  /** Redraw all charts after a change of colours. */
  redraw(): void {
    for (const chart of this.charts) chart.draw();
    for (const chart of this.charts) chart.show(this.links.clock.time);
  }

  /** Update growing curves, at most a few times a second. */
  grow(): void {
    this.waiting ||= window.setTimeout(() => {
      this.waiting = 0;
      for (const chart of this.charts) void chart.grow();
    }, INTERVAL);
  }

  private remove(chart: Chart): void {
    this.charts = this.charts.filter((other) => other !== chart);
    chart.dispose();
  }
}
