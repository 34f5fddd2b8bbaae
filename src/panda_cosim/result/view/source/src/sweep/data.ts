// The rows of a sweep as the page has them (src/panda_cosim/study/sweep/report.py writes them), and their names.
import { number as short } from "../dom.ts";
import { embedded } from "../embedded.ts";

/** Rows by value of a key: of each value if it has few, else by range. */
export interface Marginal {
  each: boolean;
  names: string[];
  starts: number[];
  ends: number[];
  rows: number[];
  bad: number[];
  bounds: [number, number][]; // of the share without success; of random samples alone
}

/** Rows in cells of two keys; the second key varies fastest. */
export interface Cells {
  keys: [string, string];
  names: [string[], string[]];
  ticks: [string[], string[]];
  rows: number[];
  bad: number[];
}

interface Metric {
  what: string;
  unit: string;
  better: "" | "lower" | "higher";
}

interface SweepData {
  keys: string[];
  labels: Record<string, string[]>; // of keys whose values are words: point v is labels[v]
  metrics: Record<string, Metric>;
  units: Record<string, string>;
  points: Record<string, (number | null)[]>; // keys and metrics of the rows that are drawn
  index: number[];
  bad: number[];
  total: number;
  marginals: Record<string, Marginal>;
  maps: Cells[];
  isGrid: boolean;
  nominal: Record<string, number>;
  influences: Record<string, [key: string, value: number, low: number | null, high: number | null][]> | null;
  search: false | "fail" | "best";
  searched: string;
  results: string[];
  errors: string[];
  commands: string[];
  show: string;
  views: Record<string, string>;
}

export const data = embedded("sweep") as SweepData;
export const FAILURES = "failures"; // the share of rows without success, beside the metrics

/** What is shown. */
export const state = { metric: "", key: data.keys[0], colour: "", pair: 0, all: false, row: null as number | null };
export type Choose = (changes: Partial<typeof state>) => void;

export const hasFailures = data.bad.some(Boolean);
export const hasValues = (name: string): boolean => data.points[name]?.some((v) => v !== null) ?? false;
/** Rows without success are drawn last, on top. */
export const drawingOrder = [...data.bad.keys()].sort((a, b) => data.bad[a] - data.bad[b]);

export const known = (values: readonly (number | null)[]): number[] => values.filter((v) => v !== null);
export const ends = (values: readonly number[]): [number, number] => [Math.min(...values), Math.max(...values)];
/** Whether two numbers are the same but for rounding. */
export const isSame = (a: number, b: number): boolean => Math.abs(b - a) <= 1e-9 + 1e-6 * Math.max(Math.abs(a), Math.abs(b));
export const varies = (name: string): boolean => !isSame(...ends(known(data.points[name])));

export const isMargin = (name: string): boolean => name.split(".")[0] === "margin";
const unit = (name: string): string => (isMargin(name) ? "" : data.metrics[name]?.unit ?? data.units[name] ?? "");
export const better = (name: string): string => (isMargin(name) ? "higher" : data.metrics[name]?.better ?? "");

export const number = (v: number | null): string => (v === null ? "none" : short(v));
export const withUnit = (text: string, name: string): string => (unit(name) ? `${text} ${unit(name)}` : text);

/** A row's value of a key or metric in words. */
export function value(name: string, v: number | null): string {
  if (v === null) return "none";
  return data.labels[name]?.[v] ?? withUnit(number(v), name);
}

/** A metric's name without its section and unit, which are written beside it. */
export function called(name: string): string {
  if (name === FAILURES) return "rows without success";
  const end = unit(name) && `_${unit(name)}`;
  const [, stem, index] = /^(.*?)((?:\[\d+\])?)$/s.exec(name.replace(/^summary\./, ""))!;
  return (end && stem.endsWith(end) ? stem.slice(0, -end.length) : stem) + index;
}

/** A name with its unit. */
export function title(name: string): string {
  const of = name === FAILURES ? "%" : unit(name);
  return of ? `${called(name)} [${of}]` : called(name);
}

export function meaning(name: string): string {
  const { what } = data.metrics[name] ?? {};
  const margin = name === "margin" ? what : `margin of ${name.slice(7)}${what && `: ${what}`}`;
  if (isMargin(name)) return `${margin}. Not given if the run did not finish, or a criterion could not be measured.`;
  return what ?? "Rows without success, as a share of all rows with that value or within that range; with bounds of 95 % confidence if the rows are random samples.";
}

/** Names may be of any length; what distinguishes them is often at their end. */
export const fit = (name: string, most: number): string => (name.length > most ? `${name.slice(0, most - 9)}…${name.slice(-8)}` : name);

/** All that is known about a row: how it ended first. */
export function facts(row: number): string[] {
  const names = state.metric === FAILURES ? [] : [state.metric];
  const numbers = names.map((name) => `${called(name)} ${value(name, data.points[name][row])}`);
  return [`Row ${data.index[row]}: ${data.results[row]}`, ...numbers, ...data.keys.map((key) => `${key} ${value(key, data.points[key][row])}`)];
}
