// Runs and models embedded in the page, each parsed when it is first shown.
import { embedded } from "../embedded.ts";
import { RecordedRun } from "./recorded.ts";
import type { ModelData, RunData } from "./types.ts";

const opened = new Map<string, Promise<RecordedRun>>();

/** Return a run of the page by its name; rejects if there is none. */
export function openRun(name: string): Promise<RecordedRun> {
  if (!opened.has(name)) opened.set(name, read(name));
  return opened.get(name)!;
}

async function read(name: string): Promise<RecordedRun> {
  const run = embedded(`run:${name}`) as RunData | null;
  if (!run) throw new Error(`the page has no run ${name}`);
  const model = embedded(`model:${run.model}`) as ModelData | null;
  if (run.model && !model) throw new Error(`the page has no model for run ${name}`);
  return RecordedRun.open(run, model);
}
