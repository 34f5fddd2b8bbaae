// Parallel coordinates: a line for each row, across an axis for each key.
import { legible } from "../dom.ts";
import { data, ends, FAILURES, fit, known, state, title, value } from "./data.ts";

const HEIGHT = 368; // [px]
const TOP = 52;
const BOTTOM = 338;
const MARGIN = 80;
const NEAR = 30; // [px] from an axis

/** The selected range of each axis, as shares of its height. */
export const chosen = new Map<string, [low: number, high: number]>();

/** An axis: where it stands, and its reach. */
class Axis {
  readonly points: readonly (number | null)[];
  readonly reach: [number, number];

  constructor(readonly name: string, readonly x: number) {
    this.points = data.points[name];
    this.reach = ends(known(this.points));
  }

  /** Where a value stands, as a share of the axis's height; a value that is the same in all rows in the middle. */
  share(v: number): number {
    const [low, high] = this.reach;
    return high > low ? (v - low) / (high - low) : 0.5;
  }

  selects(row: number): boolean {
    const span = chosen.get(this.name);
    const v = this.points[row];
    return !span || (v !== null && this.share(v) >= span[0] && this.share(v) <= span[1]);
  }
}

const y = (share: number) => BOTTOM - share * (BOTTOM - TOP);

export class Parallel {
  private axes: Axis[] = [];
  private brushed: { name: string; from: number } | null = null;

  constructor(private readonly canvas: HTMLCanvasElement, private readonly says: HTMLElement) {
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.release(event));
  }

  draw(): void {
    const names = [...data.keys, ...(state.metric === FAILURES ? [] : [state.metric])];
    const width = Math.max(this.canvas.parentElement!.clientWidth, 110 * names.length);
    this.axes = names.map((name, i) => new Axis(name, MARGIN + (i * (width - 2 * MARGIN)) / Math.max(names.length - 1, 1)));
    const kept = data.bad.map((_, row) => this.axes.every((axis) => axis.selects(row)));
    const pen = this.sized(width);
    const ink = getComputedStyle(this.canvas);
    const dense = Math.min(1, 120 / kept.length + 0.12);
    const pass = (style: string, alpha: number, test: (row: number) => boolean) => {
      pen.strokeStyle = ink.getPropertyValue(style);
      pen.globalAlpha = alpha;
      for (const row of kept.keys()) if (test(row)) this.line(pen, row);
      pen.globalAlpha = 1;
    };
    if (chosen.size) pass("--line", dense, (row) => !kept[row]);
    pass("--accent", dense, (row) => kept[row] && !data.bad[row]);
    pass("--bad", Math.min(1, dense * 2), (row) => kept[row] && !!data.bad[row]);
    pen.strokeStyle = pen.fillStyle = ink.getPropertyValue("--ink");
    this.axes.forEach((axis, i) => drawAxis(pen, axis, i % 2 ? 32 : 14));
    const failing = kept.filter((k, row) => k && data.bad[row]).length;
    this.says.textContent = chosen.size ? `${kept.filter(Boolean).length} of ${kept.length} drawn rows selected, ${failing} of them without success.` : "";
  }

  private sized(width: number): CanvasRenderingContext2D {
    const { canvas } = this;
    canvas.width = width * devicePixelRatio;
    canvas.height = HEIGHT * devicePixelRatio;
    canvas.style.width = `${width}px`;
    canvas.style.height = `${HEIGHT}px`;
    const pen = canvas.getContext("2d")!;
    pen.scale(devicePixelRatio, devicePixelRatio);
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "center";
    return pen;
  }

  private line(pen: CanvasRenderingContext2D, row: number): void {
    pen.beginPath();
    for (const axis of this.axes) {
      const v = axis.points[row];
      if (v !== null) pen.lineTo(axis.x, y(axis.share(v)));
    }
    pen.stroke();
  }

  /** The place of a pointer as a share of an axis's height. */
  private share(event: PointerEvent): number {
    const top = this.canvas.getBoundingClientRect().top;
    return Math.min(Math.max((BOTTOM - (event.clientY - top)) / (BOTTOM - TOP), 0), 1);
  }

  private press(event: PointerEvent): void {
    const px = event.clientX - this.canvas.getBoundingClientRect().left;
    const axis = this.axes.find(({ x }) => Math.abs(px - x) <= NEAR);
    if (!axis) return;
    this.brushed = { name: axis.name, from: this.share(event) };
    this.canvas.setPointerCapture(event.pointerId);
    event.preventDefault();
  }

  private move(event: PointerEvent): void {
    if (!this.brushed) return;
    const { name, from } = this.brushed;
    const to = this.share(event);
    chosen.set(name, [Math.min(from, to), Math.max(from, to)]);
    this.draw();
  }

  private release(event: PointerEvent): void {
    if (!this.brushed) return;
    const { name, from } = this.brushed;
    if (Math.abs(this.share(event) - from) < 0.01) chosen.delete(name);
    this.brushed = null;
    this.draw();
  }
}

/** Draw an axis with its name, its ends and its selected range. */
function drawAxis(pen: CanvasRenderingContext2D, { name, x, reach: [low, high] }: Axis, nameAt: number): void {
  const write = (text: string, at: number) => pen.fillText(legible(text), x, at);
  pen.beginPath();
  pen.moveTo(x, TOP);
  pen.lineTo(x, BOTTOM);
  pen.stroke();
  write(fit(title(name).replace(/^(plant|controller)\./, ""), 26), nameAt);
  write(value(name, high), TOP - 3);
  if (high > low) write(value(name, low), BOTTOM + 16);
  const span = chosen.get(name);
  if (!span) return;
  pen.globalAlpha = 0.25;
  pen.fillRect(x - 8, y(span[1]), 16, y(span[0]) - y(span[1]));
  pen.globalAlpha = 1;
}
