// The socket to a live simulation: it receives rows and sends commands.

import type { Mark } from "../data/types.ts";

/** What the user can do to the simulation. */
export type Command =
  | { do: "play" | "pause" | "restart" }
  | { do: "step"; ticks: number }
  | { do: "speed"; factor: number }
  | { do: "set"; name: string; value: number | boolean | string | number[] }
  | { do: "release"; name: string }
  | { do: "waypoint"; row: number; position: number[] }
  | { do: "keep"; name: string }
  | { do: "coupling"; coupling: string };

/** A tunable parameter. */
export interface Tunable {
  name: string;
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
  closed(): void;
}

export class Link {
  private socket: WebSocket | null = null;
  private readonly early: Command[] = []; // given before the socket opened

  open(events: LinkEvents): void {
    const address = new URL("live", location.href);
    address.protocol = "ws:";
    address.search = location.search; // the token
    address.hash = "";
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => this.early.splice(0).forEach((command) => this.send(command)));
    socket.addEventListener("message", ({ data }) => take(data as ArrayBuffer | string, events));
    socket.addEventListener("close", () => events.closed());
    this.socket = socket;
  }

  send(command: Command): void {
    const state = this.socket?.readyState ?? WebSocket.CONNECTING;
    if (state === WebSocket.CONNECTING) this.early.push(command);
    else if (state === WebSocket.OPEN) this.socket?.send(JSON.stringify(command));
  }
}

function take(data: ArrayBuffer | string, events: LinkEvents): void {
  if (typeof data !== "string") {
    events.rows(new Float64Array(data));
    return;
  }
  const said = JSON.parse(data) as { status: Status } | { plan: Plan } | { refused: string };
  if ("status" in said) events.status(said.status);
  else if ("plan" in said) events.plan(said.plan);
  else events.refused(said.refused);
}
