// A list of all signals to search in; what is chosen becomes a chart.
import type { Signal } from "../data/source.ts";
import { make } from "../dom.ts";

const SHOWN = 60; // entries at once

interface Entry {
  title: string;
  columns: string[];
  words: string;
  text: string;
}

/** Return whole signals first, then each of their elements. */
function entries(signals: readonly Signal[]): Entry[] {
  const entry = (title: string, columns: string[], { words, unit }: Signal): Entry => {
    const note = [unit !== "1" ? unit : "", columns.length > 1 ? `${columns.length} elements` : "", words].filter(Boolean).join(" · ");
    return { title, columns, words: note, text: `${title} ${words}`.toLowerCase() };
  };
  const whole = signals.map((signal) => entry(signal.name, signal.columns, signal));
  const parts = signals.filter(({ columns }) => columns.length > 1).flatMap((signal) => signal.columns.map((column) => entry(column, [column], signal)));
  return [...whole, ...parts];
}

export function picker(signals: readonly Signal[], choose: (title: string, columns: string[]) => void): HTMLElement {
  const all = entries(signals);
  const field = make("input", "pv-search");
  const list = make("ul", "pv-found");
  let found: Entry[] = [];
  let active = 0;

  field.type = "search";
  field.placeholder = "Add a signal …";
  for (const [name, value] of Object.entries({ role: "combobox", "aria-label": "Add a signal", "aria-expanded": "false", autocomplete: "off", spellcheck: "false" }))
    field.setAttribute(name, value);
  list.setAttribute("role", "listbox");
  list.hidden = true;

  const close = () => {
    list.hidden = true;
    field.setAttribute("aria-expanded", "false");
  };
  const take = (entry: Entry) => {
    field.value = "";
    close();
    choose(entry.title, entry.columns);
  };
  const mark = (index: number) => {
    active = Math.min(Math.max(index, 0), found.length - 1);
    Array.from(list.children).forEach((item, at) => item.setAttribute("aria-selected", String(at === active)));
    list.children[active]?.scrollIntoView({ block: "nearest" });
  };
  const search = () => {
    const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
    found = all.filter(({ text }) => words.every((word) => text.includes(word))).slice(0, SHOWN);
    list.replaceChildren(...found.map((entry) => item(entry, () => take(entry))));
    if (!found.length) list.append(make("li", "pv-none", "No such signal"));
    list.hidden = false;
    field.setAttribute("aria-expanded", "true");
    mark(0);
  };
  field.addEventListener("input", search);
  field.addEventListener("focus", search);
  field.addEventListener("blur", () => setTimeout(close, 150)); // after a click in the list
  field.addEventListener("keydown", (event) => {
    event.stopPropagation(); // what is typed here moves nothing else
    if (event.key === "ArrowDown") mark(active + 1);
    else if (event.key === "ArrowUp") mark(active - 1);
    else if (event.key === "Enter" && found[active]) take(found[active]);
    else if (event.key === "Escape") field.blur();
    else return;
    event.preventDefault();
  });
  return make("div", "pv-picker", field, list);
}

function item({ title, words }: Entry, take: () => void): HTMLElement {
  const element = make("li", "", make("code", "", title), make("small", "", words));
  element.setAttribute("role", "option");
  element.addEventListener("mousedown", (event) => {
    event.preventDefault(); // the field keeps the focus until the choice is made
    take();
  });
  return element;
}
