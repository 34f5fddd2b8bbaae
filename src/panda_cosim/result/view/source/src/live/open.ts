// Opens the page of a live simulation.
import { download } from "../dom.ts";
import { embedded } from "../embedded.ts";
import { Viewer } from "../viewer.ts";
import { Drag } from "./drag.ts";
import { Link, type Command } from "./link.ts";
import { Bar, Parameters } from "./panel.ts";
import { type LiveData, LiveRun } from "./source.ts";
import { Waypoints } from "./waypoints.ts";
import { zip } from "./zip.ts";

/** Return what a page that simulates by itself gives its worker, or null. */
function engineOf({ tunables, columns, plan }: LiveData): object | null {
  const engine = embedded("engine") as object | null;
  return engine && { ...engine, tunables, columns, plan };
}

/** Return the viewer of the page's live simulation, or null if the page has none. */
export async function openLive(into: HTMLElement): Promise<Viewer | null> {
  const data = embedded("live") as LiveData | null;
  if (!data) return null;
  const link = new Link(engineOf(data));
  const send = (command: Command) => link.send(command);
  const run = new LiveRun(data);
  const parameters = new Parameters(send, data.tunables, data.couplings);
  const bar = new Bar(send, link.isAlone, () => parameters.changes());
  const viewer = await Viewer.open([run], into, {}, true, {
    footer: bar.element,
    panel: ["Parameters", parameters.element],
    keys: [
      { keys: [" "], words: "run or pause", act: () => bar.toggle() },
      { keys: ["."], words: "one step forward", act: () => bar.step() },
      { keys: ["[", "]"], words: "slower, faster", act: ({ key }) => bar.changeSpeed(key === "[" ? -1 : 1) },
    ],
  });
  viewer.clock.onTime((time) => bar.showTime(time));
  const { stage } = viewer;
  const bodies = data.pushes.flatMap((push) => push.bodies);
  const waypoints = stage && new Waypoints(stage, bodies, (row, position) => send({ do: "waypoint", row, position }), (words) => bar.say(words));
  const drag = stage && new Drag(stage, data.pushes, (name, value) => send(value ? { do: "set", name, value } : { do: "release", name }), (signal) => [1, 2, 3].map((i) => run.newest(`${signal}[${i}]`)));
  if (waypoints) parameters.element.append(waypoints.element);
  viewer.clock.onTime((time) => {
    waypoints?.show(time);
    drag?.update(time);
  });
  // What is not simulated cannot be dragged.
  const hold = (can: boolean) => [waypoints, drag].forEach((each) => each && (each.enabled = can));
  // Rows may arrive faster than a slow machine draws, so they are shown once per frame.
  let waiting = 0;
  const catchUp = () => {
    waiting = 0;
    run.grown();
    viewer.clock.seek(run.span[1]);
  };
  link.open({
    rows: (values) => {
      run.take(values);
      waiting ||= requestAnimationFrame(catchUp);
    },
    status: (status) => {
      bar.show(status);
      parameters.show(status);
      hold(status.acts && !status.over);
    },
    plan: (plan) => {
      run.use(plan);
      waypoints?.use(plan);
    },
    refused: (words) => bar.say(words),
    journal: (files) => download("session.zip", zip(files)),
    closed: () => {
      hold(false);
      bar.say("the simulation has ended; its folder holds the run and session.jsonl");
    },
  });
  return viewer;
}
