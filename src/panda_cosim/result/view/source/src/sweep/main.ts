// Entry point of a sweep's report: what is chosen, and the plots of it.
import "./style.css";
import { legible, option } from "../dom.ts";
import { chart } from "./chart.ts";
import { better, called, data, FAILURES, fit, hasFailures, hasValues, isMargin, meaning, state, title, varies } from "./data.ts";
import { influence } from "./influence.ts";
import { map } from "./map.ts";
import { dark } from "./marks.ts";
import { chosen, Parallel } from "./parallel.ts";
import { bestSoFar, progress } from "./progress.ts";
import { details, table } from "./rows.ts";

export { bestSoFar, chosen, data, state };

const LONGEST = 80; // characters of a choice
const SAME = "same in all rows";

const byId = (id: string): HTMLElement => document.getElementById(id)!;
const lists = { metric: byId("metric") as HTMLSelectElement, key: byId("key") as HTMLSelectElement, colour: byId("colour") as HTMLSelectElement, pair: byId("pair") as HTMLSelectElement };
const parallel = new Parallel(byId("parallel") as HTMLCanvasElement, byId("brushed"));
const choices = (names: readonly string[]): HTMLOptionElement[] => names.map((name) => option(name, fit(title(name), LONGEST)));

/** The metrics that there are, by group; those that do not vary come last. */
function metrics(): Map<string, string[]> {
  const groups = new Map<string, string[]>(hasFailures ? [["verdict", [FAILURES]]] : []);
  const same: string[] = [];
  for (const name of Object.keys(data.metrics)) {
    const margin = isMargin(name);
    if (!hasValues(name) || (margin && !varies(name))) continue;
    const group = name === "margin" ? "verdict" : margin ? "margins" : name.startsWith("event.") ? "events" : called(name).split(".")[0];
    if (!varies(name)) same.push(name);
    else groups.set(group, [...(groups.get(group) ?? []), name]);
  }
  return same.length ? groups.set(SAME, same) : groups;
}

/** The margin if rows failed, else the first metric that tells them apart. */
function firstMetric(all: readonly string[]): string {
  const told = hasFailures
    ? all.find((name) => name === "margin") ?? FAILURES
    : all.find((name) => !isMargin(name) && better(name) && varies(name));
  return told ?? all[0] ?? "margin";
}

function offer(): void {
  const groups = metrics();
  state.metric = firstMetric([...groups.values()].flat());
  for (const [group, names] of groups) {
    const into = document.createElement("optgroup");
    into.label = legible(group);
    into.append(...choices(names));
    lists.metric.append(into);
  }
  if (data.isGrid) state.colour = data.keys[1] ?? "";
  lists.key.append(...choices(data.keys));
  lists.colour.append(option("", "nothing"), ...choices(data.keys));
  lists.pair.append(...data.maps.map(({ keys }, i) => option(String(i), fit(keys.map(title).join(" and "), LONGEST))));
}

function choose(changes: Partial<typeof state>): void {
  Object.assign(state, changes);
  if (state.colour === state.key) state.colour = "";
  draw();
}

function draw(): void {
  for (const [name, list] of Object.entries(lists)) list.value = String(state[name as keyof typeof lists]);
  byId("meaning").textContent = meaning(state.metric);
  if (state.metric === FAILURES || hasValues(state.metric)) {
    chart(byId("chart"), byId("legend"), byId("hint"));
    if (data.maps.length) map(byId("map"), byId("shades"));
    table(byId("worst"), byId("more"), choose);
  }
  const influences = document.getElementById("influence");
  if (influences) influence(influences, choose);
  if (data.keys.length > 2) parallel.draw();
  if (data.search) progress(byId("search"));
  details(byId("details"));
}

offer();
byId("map-section").hidden = !data.maps.length;
byId("parallel-section").hidden = data.keys.length < 3;
byId("search-section").hidden = !data.search;
lists.metric.addEventListener("change", () => choose({ metric: lists.metric.value }));
lists.key.addEventListener("change", () => choose({ key: lists.key.value }));
lists.colour.addEventListener("change", () => choose({ colour: lists.colour.value }));
lists.pair.addEventListener("change", () => choose({ pair: Number(lists.pair.value) }));
byId("more").addEventListener("click", () => choose({ all: !state.all }));
for (const plot of [byId("chart"), byId("map")]) plot.addEventListener("click", ({ target }) => {
  const row = (target as Element).closest<SVGElement>("[data-row]")?.dataset.row;
  if (row !== undefined) choose({ row: Number(row) });
});
draw();
dark.addEventListener("change", draw);
let waiting = 0;
addEventListener("resize", () => {
  waiting ||= requestAnimationFrame(() => {
    waiting = 0;
    draw();
  });
});
