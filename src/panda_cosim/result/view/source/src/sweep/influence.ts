// How each value influences a metric.
import { button, make } from "../dom.ts";
import { type Choose, data, FAILURES, state } from "./data.ts";

export function influence(into: HTMLElement, choose: Choose): void {
  const each = data.influences?.[state.metric === FAILURES ? "margin" : state.metric] ?? [];
  if (!each.length) {
    into.replaceChildren(data.total < 10 ? `Too few rows: ${data.total}, where 10 are needed.` : "The metric does not vary, or too few rows have it.");
    return;
  }
  const low = Math.min(0, ...each.map(([, v, from]) => from ?? v));
  const high = Math.max(0.1, ...each.map(([, v, , to]) => to ?? v));
  const share = (length: number) => `${(100 * length) / (high - low)}%`;
  const bar = (kind: string, from: number, to: number) => {
    const element = make("i", kind);
    element.style.left = share(Math.min(from, to) - low);
    element.style.width = share(Math.abs(to - from));
    return element;
  };
  into.replaceChildren(...each.map(([key, v, from, to]) => {
    const range = from === null || to === null ? [] : [bar("between", from, to)];
    const track = make("span", "track", bar(v < 0 ? "less" : "more", 0, v), ...range);
    const words = `${v.toFixed(2).replace("-", "−")}${data.labels[key] ? " (words)" : ""}`;
    return make("div", "influence", button(`${key}: show over this value`, "", () => choose({ key }), key), track, make("b", "", words));
  }));
}
