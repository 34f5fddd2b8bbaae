// What all charts that uPlot draws share: axes, labels and gaps.
import uPlot from "uplot";

/** Return a value as uPlot takes it: null is a gap. */
export function gap(value: number): number | null {
  return Number.isFinite(value) ? value : null;
}

/** Write a tick with enough digits to tell it from its neighbours, which are a step away. */
export function label(value: number, step: number): string {
  if (Math.abs(value) < step / 1e6) return "0";
  const place = Math.floor(Math.log10(step) + 1e-9); // of the last digit
  const size = Math.abs(value);
  const places = (most: number, wanted: number) => Math.min(Math.max(wanted, 0), most);
  const isLong = size >= 1e5 || size < 1e-3;
  const text = isLong ? value.toExponential(places(6, Math.floor(Math.log10(size)) - place)) : value.toFixed(places(9, -place));
  return text.replaceAll("-", "−");
}

/** Return both axes in colours that may change from one drawing to the next; `unit` is that of the one below. */
export function axes(colour: () => string, grid: () => string, size: number, unit: string): [uPlot.Axis, uPlot.Axis] {
  const common: uPlot.Axis = { stroke: colour, font: "11px system-ui, sans-serif", ticks: { show: false }, grid: { stroke: grid, width: 1 } };
  const values = (after: string): uPlot.Axis.DynamicValues => (_, ticks, __, ___, step) => ticks.map((tick) => label(tick, step) + after);
  return [
    { ...common, size: 24, gap: 4, values: values(` ${unit}`) },
    { ...common, size, gap: 5, values: values("") },
  ];
}

/** Write what the axis beside a plot shows, its unit for instance, into the corner of the plot. */
export function write({ ctx, bbox: { left, top } }: uPlot, words: string, colour: string): void {
  ctx.save();
  ctx.fillStyle = colour;
  ctx.font = `${11 * uPlot.pxRatio}px system-ui, sans-serif`;
  ctx.textAlign = "left";
  ctx.textBaseline = "top";
  ctx.fillText(words, left + 5 * uPlot.pxRatio, top + 4 * uPlot.pxRatio);
  ctx.restore();
}

/** uPlot hears the mouse alone; let a finger that moves along a plot act as one. */
export function hearTouch({ over }: uPlot): void {
  const names = { pointerdown: "mousedown", pointermove: "mousemove", pointerup: "mouseup" } as const;
  for (const [heard, name] of Object.entries(names)) {
    over.addEventListener(heard, (event) => {
      const { pointerType, clientX, clientY } = event as PointerEvent;
      if (pointerType !== "touch") return;
      over.dispatchEvent(new MouseEvent(name, { bubbles: true, clientX, clientY, movementX: 1 }));
    });
  }
}
