import assert from "node:assert/strict";
import { test } from "node:test";
import { number } from "../src/dom.ts";
import { Link, type LinkEvents } from "../src/live/link.ts";
import { marksByPlace } from "../src/scene/labels.ts";
import type { RunSource } from "../src/data/source.ts";

test("commands given before the socket opens are sent when it is open", () => {
  const sent: string[] = [];
  const listeners: Record<string, () => void> = {};
  class Socket {
    static readonly CONNECTING = 0;
    static readonly OPEN = 1;
    readyState = Socket.CONNECTING;
    addEventListener(kind: string, listener: () => void) {
      listeners[kind] = listener;
    }
    send(text: string) {
      assert.equal(this.readyState, Socket.OPEN);
      sent.push(text);
    }
  }
  let socket: Socket | null = null;
  const globals = globalThis as Record<string, unknown>;
  globals.location = { href: "http://127.0.0.1:1/?token=x", search: "?token=x" };
  globals.WebSocket = class extends Socket {
    constructor() {
      super();
      socket = this;
    }
  };
  const link = new Link();
  link.send({ do: "pause" });
  link.open({} as LinkEvents);
  link.send({ do: "step", ticks: 3 });
  assert.deepEqual(sent, []);
  socket!.readyState = Socket.OPEN;
  listeners.open();
  link.send({ do: "play" });
  assert.deepEqual(sent.map((text) => JSON.parse(text).do), ["pause", "step", "play"]);
});

test("waypoints at the same place have one label", () => {
  const place = [0.5, 0, 0.4] as [number, number, number];
  const waypoints = [
    { label: "1", time: 0, place: [0, 0, 0] as [number, number, number] },
    { label: "3", time: 1, place },
    { label: "4", time: 2, place },
  ];
  const spots = marksByPlace({ about: { waypoints }, at: () => null } as unknown as RunSource);
  assert.deepEqual(spots.map(({ marks }) => marks.map(({ label }) => label).join("/")), ["1", "3/4"]);
});

test("rounding noise is shown as zero", () => {
  assert.equal(number(6.6e-34), "0");
  assert.equal(number(-2.5), "−2.5");
});
