// The table of rows, the worst first, and what is known about the chosen one.
import { button, hint, make } from "../dom.ts";
import { better, type Choose, data, facts, FAILURES, hasFailures, hasValues, number, state, title, value } from "./data.ts";

const LISTED = 20;
const EXCERPT = 80; // characters of an error
const COPIED = 1200; // [ms]

/** All rows, the worst in the chosen metric first. */
function worstFirst(): number[] {
  const name = state.metric === FAILURES ? "margin" : state.metric;
  const values = data.points[name] ?? data.bad.map(() => 0);
  const sign = better(name) === "lower" ? -1 : 1;
  const ranks = values.map((v) => (v === null ? -Infinity : sign * v));
  const above = (a: number, b: number) => (ranks[a] === ranks[b] ? a - b : ranks[a] - ranks[b]);
  return [...data.index.keys()].sort((a, b) => data.bad[b] - data.bad[a] || above(a, b));
}

export function table(into: HTMLElement, more: HTMLElement, choose: Choose): void {
  const metrics = [...new Set([state.metric, ...(hasFailures ? ["margin"] : [])])].filter((name) => data.metrics[name] && hasValues(name));
  const names = [...metrics, ...data.keys];
  const rows = worstFirst();
  const head = ["Row", "Result", "3D", ...names.map(title), "Run"].map((text) => {
    const cell = make("th", "", text);
    cell.scope = "col";
    return cell;
  });
  const body = (state.all ? rows : rows.slice(0, LISTED)).map((row) => {
    const pick = button(`Row ${data.index[row]}: show in the plots`, "", () => choose({ row }), String(data.index[row]));
    return make(
      "tr",
      row === state.row ? "chosen" : "",
      make("td", "", pick),
      make("td", data.bad[row] ? "bad" : "", data.results[row], ...failure(row)),
      make("td", "", opener(row)),
      ...names.map((name) => cell(name, row)),
      make("td", "", copier(data.commands[row])),
    );
  });
  into.replaceChildren(make("thead", "", make("tr", "", ...head)), make("tbody", "", ...body));
  more.hidden = rows.length <= LISTED;
  more.textContent = state.all ? `Show ${LISTED} rows` : `Show all ${rows.length} rows`;
}

function cell(name: string, row: number): HTMLElement {
  const v = data.points[name][row];
  const isWord = name in data.labels;
  const element = make("td", isWord ? "" : "number", isWord ? value(name, v) : number(v));
  hint(element, v === null ? "" : isWord ? value(name, v) : String(v));
  return element;
}

function failure(row: number): (HTMLElement | string)[] {
  const error = data.errors[row];
  if (!error) return [];
  const said = make("span", "quiet", error.slice(0, EXCERPT));
  hint(said, error);
  return [": ", said];
}

/** What is known about the chosen row, and how to see it. */
export function details(into: HTMLElement): void {
  const { row } = state;
  into.hidden = row === null;
  if (row === null) return;
  const [ended, ...rest] = facts(row);
  const line = (words: string, command: string) => make("p", "", `${words}: `, make("code", "", command), " ", copier(command));
  into.replaceChildren(
    make("b", "", ended),
    make("p", "", [...rest, ...(data.errors[row] ? [data.errors[row]] : [])].join(" · ")),
    data.views[data.index[row]] ? make("p", "", opener(row)) : line("To see it in 3D", repeats(row)),
    line("To run it again", data.commands[row]),
  );
}

const repeats = (row: number) => `${data.show} ${data.index[row]}`;

/** A link to a row's 3D page, or a button that copies the command that makes it. */
function opener(row: number): HTMLElement {
  const address = data.views[data.index[row]];
  if (!address) return copier(repeats(row));
  const link = make("a", "", "Open in 3D");
  link.href = address;
  return link;
}

function copier(command: string): HTMLElement {
  const words = "Copy command";
  const element = button(`${words}: ${command}`, "", () => void copied(command).then(() => {
    element.textContent = "Copied";
    setTimeout(() => { element.textContent = words; }, COPIED);
  }), words);
  element.dataset.copy = command;
  return element;
}

async function copied(text: string): Promise<void> {
  try {
    await navigator.clipboard.writeText(text);
  } catch { // a page from a file has no clipboard in some browsers
    const area = make("textarea");
    area.value = text;
    document.body.append(area);
    area.select();
    document.execCommand("copy");
    area.remove();
  }
}
