// Colours of curves and marks.

import palette from "../../../palette.json";

/** Colours that most people can tell apart, on white and on black: Okabe and Ito's, and two more. */
export const PALETTE = Object.values(palette.curves);

export type Rgb = readonly number[]; // 0 to 255

/** Even in lightness, from dark to light. */
export const SHADES: readonly Rgb[] = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

/** Return the colour at a share, 0 to 1, of the way through some hues. */
export function shade(share: number, hues = SHADES): Rgb {
  const at = Math.min(Math.max(share, 0), 1) * (hues.length - 1);
  const i = Math.min(Math.floor(at), hues.length - 2);
  return hues[i].map((value, c) => Math.round(value + (at - i) * (hues[i + 1][c] - value)));
}

export const css = (rgb: Rgb): string => `rgb(${rgb.join(" ")})`;

/** Whether black text is read better than white on a colour. */
export const isLight = ([r, g, b]: Rgb): boolean => 0.3 * r + 0.6 * g + 0.1 * b > 125;
