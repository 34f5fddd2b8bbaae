// Elements and text. Text from a run is never interpreted as HTML.

type Child = Node | string;

const LONGEST = 1000; // characters of one text
const HIDDEN = /[\p{Cc}\p{Cf}\p{Cs}\p{Zl}\p{Zp}]/gu; // they could turn our own words around
const NEEDED = "\n\t\u200c\u200d"; // the latter two by some scripts

/** Return text from a run as it is shown: characters that are not seen are written as escapes. */
export function legible(text: string): string {
  const cut = text.length > LONGEST ? `${text.slice(0, LONGEST - 1)}…` : text;
  return cut.replace(HIDDEN, (char) => (NEEDED.includes(char) ? char : escaped(char.codePointAt(0)!)));
}

function escaped(code: number): string {
  const digits = code.toString(16);
  return code < 0x100 ? `\\x${digits.padStart(2, "0")}` : code < 0x10000 ? `\\u${digits.padStart(4, "0")}` : `\\U${digits.padStart(8, "0")}`;
}

/** Make an element with a class and children; strings become legible text. */
export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  className = "",
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  if (className) element.className = className;
  element.append(...children.map((child) => (typeof child === "string" ? legible(child) : child)));
  return element;
}

/** Put texts side by side; the direction in which one is written does not change the others. */
export function joined(texts: readonly string[], between = " · "): Child[] {
  return texts.filter(Boolean).flatMap((text, index) => [index ? between : "", make("bdi", "", text)]);
}

/** Make an option of a list. */
export function option(value: string, words = value): HTMLOptionElement {
  const element = make("option", "", words);
  element.value = value;
  return element;
}

/** Set the tooltip of an element. */
export function hint(element: HTMLElement, words: string): void {
  element.title = legible(words);
}

/** Make a button with a tooltip and a label for screen readers, which begins with its text. */
export function button(label: string, className: string, action: () => void, ...children: Child[]): HTMLButtonElement {
  const element = make("button", className, ...(children.length ? children : [label]));
  element.type = "button";
  hint(element, label);
  const text = element.textContent ?? "";
  element.setAttribute("aria-label", legible(label.includes(text) ? label : `${text}: ${label}`));
  element.addEventListener("click", action);
  return element;
}

/** Let the browser save bytes as a file. */
export function download(name: string, parts: BlobPart[]): void {
  const link = make("a");
  link.href = URL.createObjectURL(new Blob(parts));
  link.download = name;
  link.click();
  URL.revokeObjectURL(link.href);
}

const SVG = "http://www.w3.org/2000/svg";

/** Draw an element of SVG with attributes; its text becomes legible. */
export function draw<K extends keyof SVGElementTagNameMap>(
  parent: Element,
  tag: K,
  attributes: Record<string, string | number>,
  text = "",
): SVGElementTagNameMap[K] {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, typeof value === "string" ? legible(value) : String(value));
  if (text) element.textContent = legible(text);
  parent.append(element);
  return element;
}

/** Draw an icon from a path in a 24 x 24 square. */
export function icon(path: string): SVGSVGElement {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("aria-hidden", "true");
  draw(svg, "path", { d: path });
  return svg;
}

const NOISE = 1e-12; // of rounding: smaller numbers are shown as 0

/** Format a number with four digits and a true minus sign; of mm and deg, at most four decimals. */
export function number(value: number, unit = ""): string {
  if (!Number.isFinite(value)) return "–";
  if (unit === "mm" || unit === "deg") value = Number(value.toFixed(4));
  const size = Math.abs(value);
  if (size < NOISE) return "0";
  const text = size < 1e-4 || size >= 1e5 ? value.toExponential(2) : String(Number(value.toPrecision(4)));
  return text.replaceAll("-", "−");
}

/** Format a value with its unit; lengths below 1 m are in mm. */
export function quantity(value: number | null, unit: string): string {
  if (value === null) return "not measured";
  if (unit === "m" && Math.abs(value) < 1) return `${number(value * 1e3, "mm")} mm`;
  return unit === "1" || !unit ? number(value) : `${number(value, unit)} ${unit}`;
}
