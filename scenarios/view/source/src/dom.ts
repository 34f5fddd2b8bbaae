// Elements and text. Text from a run is never interpreted as HTML.

type Child = Node | string;

/** Make an element with a class and children; strings become text. */
export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  className = "",
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  if (className) element.className = className;
  element.append(...children);
  return element;
}

/** Make a button with a tooltip and a label for screen readers. */
export function button(label: string, className: string, action: () => void, ...children: Child[]): HTMLButtonElement {
  const element = make("button", className, ...(children.length ? children : [label]));
  element.type = "button";
  element.title = label;
  element.setAttribute("aria-label", label);
  element.addEventListener("click", action);
  return element;
}

const SVG = "http://www.w3.org/2000/svg";

/** Draw an icon from a path in a 24 x 24 square. */
export function icon(path: string): SVGSVGElement {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("aria-hidden", "true");
  const line = document.createElementNS(SVG, "path");
  line.setAttribute("d", path);
  svg.append(line);
  return svg;
}

const NOISE = 1e-12; // of rounding: smaller numbers are shown as 0

/** Format a number with four digits and a true minus sign. */
export function number(value: number): string {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size < NOISE) return "0";
  const text = size < 1e-3 || size >= 1e5 ? value.toExponential(2) : String(Number(value.toPrecision(4)));
  return text.replaceAll("-", "−");
}

/** Format a value with its unit; lengths below 1 m are in mm. */
export function quantity(value: number | null, unit: string): string {
  if (value === null) return "not measured";
  if (unit === "m" && Math.abs(value) < 1) return `${number(value * 1e3)} mm`;
  return unit === "1" || !unit ? number(value) : `${number(value)} ${unit}`;
}
