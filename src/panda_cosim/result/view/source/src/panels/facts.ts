// Criteria, shares of the robot's limits, and notes of a run.
import type { About } from "../data/source.ts";
import type { Criterion, Limit } from "../data/types.ts";
import { make, quantity } from "../dom.ts";

export function facts(about: About, ghost: About | null): HTMLElement {
  const parts: HTMLElement[] = [];
  const notes = [...new Set([...about.notes, ...(ghost?.notes ?? [])])];
  if (about.criteria.length) parts.push(make("h3", "", "Success criteria"), criteria(about.criteria));
  if (about.limits.length) parts.push(make("h3", "", "Robot limits, largest share used"), limits(about.limits));
  parts.push(make("h3", "", "About this page"), make("ul", "pv-notes", ...notes.map((note) => make("li", "", note))));
  return make("div", "pv-facts", ...parts);
}

function criteria(rows: readonly Criterion[]): HTMLElement {
  return make("div", "pv-criteria", ...rows.map(criterion));
}

function criterion({ name, value, bound, unit, ok, least, words }: Criterion): HTMLElement {
  const row = make(
    "div",
    `pv-criterion ${ok ? "pv-good" : "pv-bad"}`,
    make("span", "pv-tick", ok ? "✓" : "✗"),
    make("span", "pv-what", name),
    make("span", "pv-value", quantity(value, unit)),
    make("span", "pv-bound", `${least ? "≥" : "≤"} ${quantity(bound, unit)}`),
  );
  row.title = words;
  if (value !== null && bound) row.append(bar(least ? bound / value : value / bound, !ok));
  return row;
}

function bar(share: number, bad: boolean): HTMLElement {
  const fill = make("i", bad ? "pv-over" : "");
  fill.style.width = `${Math.min(Math.max(share, 0), 1) * 100}%`;
  return make("span", "pv-bar", fill);
}

function limits(rows: readonly Limit[]): HTMLElement {
  return make("div", "pv-limits", ...rows.map(limit));
}

/** One limit: a column per joint, and the largest share in per cent. */
function limit({ name, shares, words }: Limit): HTMLElement {
  const known = shares.map((share) => share ?? 0);
  const worst = Math.max(...known, 0);
  const columns = known.map((share, index) => {
    const fill = make("i", share > 1 ? "pv-over" : share > 0.9 ? "pv-near" : "");
    fill.style.height = `${Math.min(share, 1) * 100}%`;
    const column = make("span", "pv-column", fill);
    column.title = `${index + 1}: ${(100 * share).toFixed(1)} %`;
    return column;
  });
  const what = make("span", "pv-what", name);
  what.title = words;
  return make(
    "div",
    "pv-limit",
    what,
    make("span", "pv-columns", ...columns),
    make("span", `pv-value ${worst > 1 ? "pv-bad" : ""}`, `${(100 * worst).toFixed(0)} %`),
  );
}
