// Entry point. `PandaView.show(runs, {at, camera})` shows runs of the page; a page that names its
// runs shows them when it is opened.
import "./style.css";
import { type Place, readAddress } from "./address.ts";
import { openRun } from "./data/library.ts";
import type { RunSource } from "./data/source.ts";
import { make } from "./dom.ts";
import { embedded } from "./embedded.ts";
import { openLive } from "./live/open.ts";
import { Viewer } from "./viewer.ts";

export interface ShowOptions extends Place {
  /** Element to show it in; by default the one with id `view`. */
  into?: HTMLElement;
}

/** What a page shows when it is opened. */
interface Asked {
  runs: string[];
  at?: number; // [s]
  part?: boolean; // of a larger page, which keeps address and keys to itself
}

/** The latest viewer, for scripts and tests. */
export let viewer: Viewer | null = null;
/** Milliseconds from the start of the page to its first frame. */
export let firstPicture = NaN;

/**
 * Show a run, and a second one as its ghost.
 *
 * @param runs Names of runs in the page, or other sources of data.
 */
export async function show(runs: readonly (string | RunSource)[], options: ShowOptions = {}): Promise<Viewer> {
  const into = options.into ?? document.getElementById("view");
  if (!into) throw new Error("the page has no element with id view");
  const sources = await Promise.all(runs.map((run) => (typeof run === "string" ? openRun(run) : run)));
  if (!sources.length) throw new Error("no run to show");
  viewer?.close();
  viewer = null;
  viewer = await Viewer.open(sources, into, options, options.into === undefined);
  return viewer;
}

async function start(): Promise<void> {
  const asked = embedded("show") as Asked | null;
  const live = asked ? null : await openLive(document.getElementById("view") ?? document.body);
  const part = asked?.part ? (document.getElementById("view") ?? undefined) : undefined;
  if (asked) await show(asked.runs, { at: asked.at, ...(part ? { into: part } : readAddress(location.hash)) });
  else if (live) viewer = live;
  else return; // the page's author calls `show`
  await new Promise(requestAnimationFrame);
  firstPicture = performance.now();
}

start().catch((error: unknown) => {
  const words = error instanceof Error ? error.message : String(error);
  document.getElementById("view")?.replaceChildren(make("p", "pv-wait", `This run cannot be shown: ${words}`));
  console.error(error);
});
