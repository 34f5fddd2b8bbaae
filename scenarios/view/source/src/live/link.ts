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
  private readonly socket: WebSocket;

  constructor(private readonly events: LinkEvents) {
    const address = new URL("live", location.href);
    address.protocol = "ws:";
    address.search = location.search; // the token
    address.hash = "";
    this.socket = new WebSocket(address);
    this.socket.binaryType = "arraybuffer";
    this.socket.addEventListener("message", ({ data }) => this.take(data as ArrayBuffer | string));
    this.socket.addEventListener("close", () => this.events.closed());
  }

  send(command: Command): void {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(command));
  }

  private take(data: ArrayBuffer | string): void {
    if (typeof data !== "string") {
      this.events.rows(new Float64Array(data));
      return;
    }
    const said = JSON.parse(data) as { status: Status } | { plan: Plan } | { refused: string };
    if ("status" in said) this.events.status(said.status);
    else if ("plan" in said) this.events.plan(said.plan);
    else this.events.refused(said.refused);
  }
}
