// The simulation of a page, in a worker of its own: one message with all that it needs, then commands.
import { inflate } from "../data/codec.ts";
import type { Command } from "../live/link.ts";
import { Simulation, type SimulationData } from "./simulation.ts";

interface Begin {
  data: SimulationData;
  modules: Record<string, string>; // deflated, in base64
}

const scope = globalThis as unknown as { postMessage(message: unknown, transfer?: Transferable[]): void; onmessage(event: MessageEvent): void };

async function begin({ data, modules }: Begin): Promise<Simulation> {
  const compiled = Object.entries(modules).map(async ([name, text]) => [name, await WebAssembly.compile(await inflate(text))] as const);
  const simulation = new Simulation(data, Object.fromEntries(await Promise.all(compiled)), (message) => {
    if (typeof message === "string") scope.postMessage(message);
    else scope.postMessage(message.buffer, [message.buffer]);
  });
  await simulation.restart();
  simulation.keepOn();
  return simulation;
}

let simulation: Promise<Simulation>;
let last: Promise<void> = Promise.resolve(); // commands are carried out one after another
scope.onmessage = ({ data }: MessageEvent<Begin | string>) => {
  if (typeof data !== "string") {
    simulation = begin(data);
    simulation.catch((error: unknown) => scope.postMessage(JSON.stringify({ refused: `the simulation cannot start: ${String(error)}` })));
  } else last = last.then(async () => (await simulation).obey(JSON.parse(data) as Command));
};
