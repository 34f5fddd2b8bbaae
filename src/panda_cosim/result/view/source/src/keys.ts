// Keyboard shortcuts, and their list.
import { make } from "./dom.ts";

export interface Key {
  keys: string[];
  words: string;
  act(event: KeyboardEvent): void;
}

const MANY = 4; // keys on one line
const NAMES: Record<string, string> = { " ": "space", ArrowLeft: "←", ArrowRight: "→", ArrowUp: "↑", ArrowDown: "↓" };

/** Listen for keys in a window or an element, except while the user types; returns a function that stops it. */
export function listen(keys: readonly Key[], place: EventTarget): () => void {
  const onKey = (event: Event) => {
    if (!(event instanceof KeyboardEvent)) return;
    if (event.ctrlKey || event.metaKey || event.altKey || isTyping(event.target, event.key)) return;
    const name = event.shiftKey && event.key.startsWith("Arrow") ? `Shift ${event.key}` : event.key;
    const found = keys.find((key) => key.keys.includes(name));
    if (!found) return;
    event.preventDefault();
    found.act(event);
  };
  place.addEventListener("keydown", onKey);
  return () => place.removeEventListener("keydown", onKey);
}

/** Fields keep all keys; buttons keep space and enter. */
function isTyping(target: EventTarget | null, key: string): boolean {
  if (!(target instanceof HTMLElement)) return false;
  if (target.matches("input[type=search], input[type=text], input[type=number], textarea, select")) return true;
  return target.matches("button, summary, input[type=checkbox]") && (key === " " || key === "Enter");
}

/** Names of keys for display; of many, only the first and the last. */
function shown(names: readonly string[]): (HTMLElement | string)[] {
  const written = names.map((name) => make("kbd", "", NAMES[name] ?? name.split(" ").map((part) => NAMES[part] ?? part).join(" ")));
  return written.length > MANY ? [written[0], "to", written[written.length - 1]] : written;
}

/** Return the dialog that lists the keys. */
export function help(keys: readonly Key[]): HTMLDialogElement {
  const rows = keys.flatMap(({ keys: names, words }) => [
    make("dt", "", ...shown(names)),
    make("dd", "", words),
  ]);
  const dialog = make("dialog", "pv-help", make("h2", "", "Keys"), make("dl", "", ...rows));
  dialog.addEventListener("click", () => dialog.close());
  return dialog;
}
