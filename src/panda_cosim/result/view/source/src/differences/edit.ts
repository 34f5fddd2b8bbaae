// A figure's tube and a criterion on its signal, tried in the page; what is kept are the lines for scenario.toml.
import { legible, make, option } from "../dom.ts";
import type { Curve } from "./curve.ts";

/** What a criterion makes of a signal's values, by the words of `reduce`. */
const REDUCED: Record<string, (values: Float64Array) => number> = {
  max: (values) => values.reduce((most, value) => Math.max(most, value), -Infinity),
  min: (values) => values.reduce((least, value) => Math.min(least, value), Infinity),
  peak: (values) => values.reduce((most, value) => Math.max(most, Math.abs(value)), 0),
  final: (values) => values[values.length - 1],
};

export const quoted = (text: string): string => JSON.stringify(text); // as TOML has it, too

/** Return the line of [regression] that gives a signal's tube this half-width. */
export function tubeLines(name: string, tolerance: number): string {
  return `[regression]\n${quoted(name)} = ${tolerance}`;
}

/** Return the lines of a criterion. */
export function criterionLines(name: string, reduce: string, side: string, bound: number): string {
  return `[[success.signal]]\nsignal = ${quoted(name)}\nreduce = ${quoted(reduce)}\n${side} = ${bound}`;
}

/** Return how many drawn instants a run is outside the tube, if its half-width were another. */
export function outside(curve: Curve, tolerance: number): number {
  const wider = tolerance - (curve.tolerance ?? 0);
  const [lower, upper] = curve.tube;
  const isOut = (value: number, row: number) => value > upper[row] + wider || value < lower[row] - wider || !Number.isFinite(value);
  return curve.runs[0].differences.filter(isOut).length;
}

/** Return the part of a figure that edits; `moved` draws the tube with another half-width. */
export function editor(curve: Curve, name: string, moved: (tolerance: number) => void): HTMLElement {
  const unit = curve.unit ? ` ${curve.unit}` : "";
  const lines = make("pre", "lines");
  const says = make("output", "says");
  const number = (label: string, value: number) => {
    const field = make("input");
    field.type = "number";
    field.step = "any";
    field.value = String(Number(value.toPrecision(3)));
    field.setAttribute("aria-label", legible(`${label} of ${name}${unit && `,${unit}`}`));
    return field;
  };
  const tolerance = number("tolerance", curve.tolerance ?? 0);
  const show = () => {
    const width = Number(tolerance.value);
    if (!(width > 0)) return;
    moved(width);
    says.textContent = `outside at ${outside(curve, width)} of ${curve.time.length} drawn instants`;
    lines.textContent = tubeLines(name, width);
  };
  const reduce = make("select", "", ...Object.keys(REDUCED).map((word) => option(word)));
  const side = make("select", "", option("below"), option("above"));
  reduce.setAttribute("aria-label", "reduce");
  side.setAttribute("aria-label", "side of the bound");
  const bound = number("bound", 0);
  const judge = () => {
    const value = REDUCED[reduce.value](curve.runs[0].values.filter(Number.isFinite));
    const isOk = side.value === "below" ? value <= Number(bound.value) : value >= Number(bound.value);
    says.textContent = `${isOk ? "holds" : "is missed"}: ${reduce.value} is ${value.toPrecision(6)}${unit} (of drawn instants)`;
    lines.textContent = criterionLines(name, reduce.value, side.value, Number(bound.value));
  };
  const propose = () => {
    bound.value = String(Number(REDUCED[reduce.value](curve.runs[0].values.filter(Number.isFinite)).toPrecision(3)));
    judge();
  };
  tolerance.addEventListener("input", show);
  reduce.addEventListener("input", propose);
  for (const field of [side, bound]) field.addEventListener("input", judge);
  const part = make(
    "details",
    "edit",
    make("summary", "", "Edit tube or criterion"),
    make("p", "", "Tube: ", tolerance, unit),
    make("p", "", "Criterion: ", reduce, " ", side, " ", bound, unit),
    says,
    lines,
    make("small", "", "Lines for scenario.toml; nothing is saved here."),
  );
  part.addEventListener("toggle", () => (part.open ? show() : moved(curve.tolerance ?? 0)));
  return part;
}
