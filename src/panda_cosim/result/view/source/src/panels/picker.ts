// A search field for signals; the chosen one becomes a chart.
import type { Signal } from "../data/source.ts";
import { joined, make } from "../dom.ts";

const SHOWN = 60; // entries shown at most

interface Entry {
  title: string;
  columns: string[];
  words: string[];
  text: string;
}

/** Return whole signals first, then each of their elements. */
function entries(signals: readonly Signal[]): Entry[] {
  const entry = (title: string, columns: string[], { words, unit }: Signal): Entry => {
    const notes = [unit !== "1" ? unit : "", columns.length > 1 ? `${columns.length} elements` : "", words];
    return { title, columns, words: notes, text: `${title} ${words}`.toLowerCase() };
  };
  const whole = signals.map((signal) => entry(signal.name, signal.columns, signal));
  const parts = signals.filter(({ columns }) => columns.length > 1).flatMap((signal) => signal.columns.map((column) => entry(column, [column], signal)));
  return [...whole, ...parts];
}

/** The search field and its list of matches. */
export class Picker {
  readonly element: HTMLElement;
  private readonly field = make("input", "pv-search");
  private readonly list = make("ul", "pv-found");
  private readonly all: Entry[];
  private found: Entry[] = [];
  private active = 0;

  constructor(
    signals: readonly Signal[],
    private readonly choose: (title: string, columns: string[]) => void,
  ) {
    this.all = entries(signals);
    this.field.type = "search";
    this.field.placeholder = "Add a signal …";
    const roles = { role: "combobox", "aria-label": "Add a signal", autocomplete: "off", spellcheck: "false" };
    for (const [name, value] of Object.entries(roles)) this.field.setAttribute(name, value);
    this.list.setAttribute("role", "listbox");
    this.open(false);
    this.field.addEventListener("input", () => this.search());
    this.field.addEventListener("focus", () => this.search());
    this.field.addEventListener("blur", () => this.open(false));
    this.field.addEventListener("keydown", (event) => this.pressed(event));
    this.element = make("div", "pv-picker", this.field, this.list);
  }

  private open(open: boolean): void {
    this.list.hidden = !open;
    this.field.setAttribute("aria-expanded", String(open));
  }

  private search(): void {
    const words = this.field.value.toLowerCase().split(/\s+/).filter(Boolean);
    this.found = this.all.filter(({ text }) => words.every((word) => text.includes(word))).slice(0, SHOWN);
    this.list.replaceChildren(...this.found.map((entry) => item(entry, () => this.take(entry))));
    if (!this.found.length) this.list.append(make("li", "pv-none", "No such signal"));
    this.open(true);
    this.mark(0);
  }

  private mark(index: number): void {
    this.active = Math.min(Math.max(index, 0), this.found.length - 1);
    const items = Array.from(this.list.children);
    items.forEach((element, at) => element.setAttribute("aria-selected", String(at === this.active)));
    items[this.active]?.scrollIntoView({ block: "nearest" });
  }

  private take({ title, columns }: Entry): void {
    this.field.value = "";
    this.field.blur();
    this.choose(title, columns);
  }

  private pressed(event: KeyboardEvent): void {
    event.stopPropagation(); // keys typed here are not shortcuts
    const chosen = this.found[this.active];
    if (event.key === "ArrowDown") this.mark(this.active + 1);
    else if (event.key === "ArrowUp") this.mark(this.active - 1);
    else if (event.key === "Enter" && chosen) this.take(chosen);
    else if (event.key === "Escape") this.field.blur();
    else return;
    event.preventDefault();
  }
}

function item({ title, words }: Entry, take: () => void): HTMLElement {
  const element = make("li", "", make("code", "", title), make("small", "", ...joined(words)));
  element.setAttribute("role", "option");
  element.addEventListener("mousedown", (event) => {
    event.preventDefault(); // keep the focus in the field until the choice is made
    take();
  });
  return element;
}
