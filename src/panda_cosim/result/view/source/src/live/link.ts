// The link to a live simulation, behind a socket or in a worker of the page: it receives rows and
// sends commands.
import type { Mark } from "../data/types.ts";
import { inflate } from "../data/codec.ts";

/** What the user can do to the simulation. */
export type Command =
  | { do: "play" | "pause" | "restart" }
  | { do: "step"; ticks: number }
  | { do: "speed"; factor: number }
  | { do: "set"; name: string; value: number | boolean | string | number[] }
  | { do: "release"; name: string }
  | { do: "waypoint"; row: number; position: number[] }
  | { do: "keep"; name: string }
  | { do: "journal" } // of a worker
  | { do: "set_coupling"; coupling: string };

/** A tunable parameter. */
export interface Tunable {
  name: string;
  reference: number; // of its value
  start: Value;
  unit: string;
  words: string;
  minimum: number | null;
  maximum: number | null;
  kind: string; // Real, Boolean, Enumeration ...
  choices: string[]; // of an Enumeration
}

export type Value = number | boolean | string;

/** The commanded path, and the rows of the table. */
export interface Plan {
  time: number[];
  points: number[];
  waypoints: Required<Mark>[];
}

/** State of the simulation. */
export interface Status {
  run: number; // counts restarts
  playing: boolean;
  over: boolean;
  speed: number;
  coupling: string;
  values: Record<string, Value>;
  behind: number; // [s]
  folder: string;
  message: string;
  acts: boolean; // whether this page has control
}

export interface LinkEvents {
  rows(values: Float64Array): void;
  status(status: Status): void;
  plan(plan: Plan): void;
  refused(words: string): void;
  journal(files: Record<string, string>): void;
  closed(): void;
}

/** Sends a message. */
type Post = (message: string) => void;

export class Link {
  /** Whether the page simulates by itself. */
  readonly isAlone: boolean;
  private post: Post | null = null;
  private readonly early: Command[] = []; // given before the link was open

  constructor(private readonly engine: unknown = null) {
    this.isAlone = engine !== null;
  }

  open(events: LinkEvents): void {
    if (this.isAlone) this.startWorker(events).catch((error: unknown) => events.refused(`the page cannot simulate: ${String(error)}`));
    else this.openSocket(events);
  }

  send(command: Command): void {
    if (this.post) this.post(JSON.stringify(command));
    else this.early.push(command);
  }

  private begin(post: Post): void {
    this.post = post;
    this.early.splice(0).forEach((command) => this.send(command));
  }

  private openSocket(events: LinkEvents): void {
    const address = new URL("live", location.href);
    address.protocol = "ws:";
    address.search = location.search; // the token
    address.hash = "";
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => this.begin((message) => socket.readyState === WebSocket.OPEN && socket.send(message)));
    socket.addEventListener("message", ({ data }) => take(data as ArrayBuffer | string, events));
    socket.addEventListener("close", () => events.closed());
  }

  private async startWorker(events: LinkEvents): Promise<void> {
    const parts = Array.from(document.querySelectorAll<HTMLElement>("script[data-module]"), (part) => [part.dataset.module!, part.textContent!]);
    const code = await inflate(document.querySelector("script[data-worker]")!.textContent!);
    const worker = new Worker(URL.createObjectURL(new Blob([code], { type: "text/javascript" })));
    worker.addEventListener("message", ({ data }) => take(data as ArrayBuffer | string, events));
    worker.addEventListener("error", ({ message }) => events.refused(`the page cannot simulate: ${message}`));
    worker.postMessage({ data: this.engine, modules: Object.fromEntries(parts) });
    this.begin((message) => worker.postMessage(message));
  }
}

function take(data: ArrayBuffer | string, events: LinkEvents): void {
  if (typeof data !== "string") {
    events.rows(new Float64Array(data));
    return;
  }
  const said = JSON.parse(data) as { status: Status } | { plan: Plan } | { refused: string } | { journal: Record<string, string> };
  if ("status" in said) events.status(said.status);
  else if ("plan" in said) events.plan(said.plan);
  else if ("journal" in said) events.journal(said.journal);
  else events.refused(said.refused);
}
