// Steps a system in real time, and carries out commands between two rows, as a server of pages
// does it: one protocol.
import type { Command, Plan, Status, Tunable, Value } from "../live/link.ts";
import { type Modules, System, type SystemData } from "./system.ts";

export interface SimulationData extends SystemData {
  tunables: Tunable[];
  plan: Plan;
  offsets: number[][]; // of each row in its frame: x, y, z [m], and how the frame is turned about z [rad]
  moves: boolean; // whether waypoints can be moved
  head: object; // of the journal
  files: Record<string, string>; // of the scenario, for the journal
}

/** What a simulation tells its page: a message as JSON, or a row. */
export type Tell = (message: string | Float64Array) => void;

type Action = { tick: number; action: string } & Record<string, unknown>;

const ROW = 10; // [ms] of wall time between two rows
const REST = 50; // [ms] longest time without a look at the clock
const BUSY = 30; // [ms] longest time without a look for commands
const LAG = 250; // [ms] behind the clock beyond which it does not catch up
const STATUS = 250; // [ms] between two reports of the status
const POINTS = 2000; // of a curved path
const OVER = "the scenario is over; restart begins another run";

/** A command that cannot be carried out; nothing has changed. */
class Refused extends Error {}

export class Simulation {
  private system!: System;
  private values: Record<string, Value> = {};
  private coupling = "";
  private actions: Action[] = [];
  private playing = true;
  private run = 0;
  private speed = 1;
  private message = "";
  private failed = false;
  private behind = 0; // [ms]
  private wall = 0; // where the clock was started [ms], and at which tick
  private tick = 0;

  constructor(
    private readonly data: SimulationData,
    private readonly modules: Modules,
    private readonly tell: Tell,
  ) {}

  /** Begin the first run, or another one. */
  async restart(): Promise<void> {
    if (this.failed || !this.run) this.system = await System.open(this.data, this.modules);
    this.failed = false;
    this.values = Object.fromEntries(this.data.tunables.map(({ name, start }) => [name, start]));
    this.coupling = this.data.coupling;
    this.actions = [];
    this.message = "";
    this.run++;
    this.guarded(() => this.system.begin());
    this.anchor();
    this.tellPlan();
    this.show();
  }

  /** Simulate in real time, until the page is closed. */
  keepOn(): void {
    setInterval(() => this.tellStatus(), STATUS);
    const turn = () => setTimeout(turn, this.catchUp());
    this.anchor();
    setTimeout(turn);
  }

  /** Carry out a command of the page. */
  async obey(command: Command): Promise<void> {
    try {
      await this.carryOut(command);
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      this.say({ refused: error.message });
    }
    this.tellStatus();
  }

  /** Take some steps, and show the last row. */
  advance(count: number): void {
    if (this.failed) return;
    this.guarded(() => this.system.advance(count));
    this.show();
    if (!this.system.isOver || this.failed) return;
    this.playing = false;
    this.actions.push({ tick: this.system.tick, action: "end" });
    this.message = `the scenario is over${this.system.judge.words}`;
    this.tellStatus();
  }

  /** Take the steps that are due; returns the time until the next look [ms]. */
  private catchUp(): number {
    const size = Math.max(1, Math.round((ROW * this.speed) / (1000 * this.data.step)));
    const perTick = (1000 * this.data.step) / this.speed;
    for (const began = performance.now(); this.playing; ) {
      const due = this.wall + (this.system.tick + size - this.tick) * perTick;
      const wait = due - performance.now();
      if (wait > 0) return Math.min(wait, REST);
      this.advance(size);
      this.behind = Math.max(0, performance.now() - due);
      if (this.behind > LAG) this.anchor();
      if (performance.now() - began > BUSY) return 0;
    }
    return REST;
  }

  private async carryOut(command: Command): Promise<void> {
    const isPaced = ["play", "pause", "step", "speed"].includes(command.do);
    switch (command.do) {
      case "play":
        this.checkOpen();
        this.playing = true;
        break;
      case "pause":
        this.playing = false;
        break;
      case "restart":
        await this.restart();
        break;
      case "step":
        this.checkOpen();
        this.playing = false;
        this.advance(command.ticks);
        break;
      case "speed":
        this.speed = command.factor;
        break;
      case "journal":
        this.say({ journal: this.journal() });
        break;
      case "keep":
        throw new Refused("a page keeps no scenarios: its journal holds the session");
      default:
        this.checkOpen();
        this.act(command);
    }
    if (isPaced) this.anchor();
  }

  /** Change the run, and note it. */
  private act(command: Extract<Command, { do: "set" | "release" | "waypoint" | "set_coupling" }>): void {
    let { do: action, ...given }: { do: string } = command;
    if (command.do === "set") this.set(command.name, command.value);
    else if (command.do === "set_coupling") this.system.couple((this.coupling = command.coupling));
    else if (command.do === "waypoint") [action, given] = ["move_waypoint", { row: command.row, position: this.move(command.row, command.position) }];
    else if (!this.inputs(command.name).filter((column) => this.system.held.delete(column)).length) throw new Refused(`${command.name}: is not held`);
    this.actions.push({ tick: this.system.tick, action, ...given });
  }

  private set(name: string, value: Value | number[]): void {
    const columns = this.inputs(name);
    const all = columns.length ? columns : this.data.tunables.filter((tunable) => isOf(name, tunable.name));
    if (!all.length) throw new Refused(`${name}: is no external input, and no parameter that can be tuned`);
    const values = Array.isArray(value) ? value : all.map(() => value);
    if (values.length !== all.length) throw new Refused(`${name}: ${values.length} values; must be ${all.length}`);
    if (columns.length) columns.forEach((column, i) => this.system.held.set(column, Number(values[i])));
    else this.tune(all as Tunable[], values);
  }

  private tune(tunables: readonly Tunable[], values: readonly Value[]): void {
    const numbers = tunables.map((tunable, i) => numberOf(tunable, values[i]));
    this.guarded(() => tunables.forEach((tunable, i) => this.system.set(tunable, numbers[i])));
    tunables.forEach(({ name }, i) => (this.values[name] = values[i]));
  }

  /** Columns of an external input, or of one of its elements. */
  private inputs(name: string): number[] {
    const { columns, external } = this.data;
    return columns.flatMap((column, i) => (i >= 1 && i <= external.length && isOf(name, column) ? [i] : []));
  }

  /** Move a row to a place in the world; returns the place in the row's own frame [m]. */
  private move(row: number, place: readonly number[]): number[] {
    const { offsets, plan } = this.data;
    const { trajectory, time } = this.system;
    if (!this.data.moves) throw new Refused("waypoints stay where they are in a page if `timing` is set");
    if (!(row in offsets)) throw new Refused(`waypoint: row ${row}; must be from 0 to ${offsets.length - 1}`);
    if (trajectory.times[row] <= time) throw new Refused(`waypoint ${plan.waypoints[row].label} has passed`);
    const [px, py, pz, turn] = offsets[row];
    const [x, y, z] = place.map((value, axis) => value - this.data.trajectory.positions[row][axis]);
    const [cosine, sine] = [Math.cos(turn), Math.sin(turn)];
    trajectory.move(row, place);
    this.tellPlan();
    return [px + cosine * x + sine * y, py + cosine * y - sine * x, pz + z];
  }

  /** Whatever an engine fails at ends the run, and is told. */
  private guarded(call: () => void): void {
    try {
      call();
    } catch (error) {
      this.failed = true;
      this.playing = false;
      this.message = `t = ${this.system.time.toFixed(3)} s: ${error instanceof Error ? error.message : String(error)}`;
      this.tellStatus();
    }
  }

  private checkOpen(): void {
    if (this.failed) throw new Refused(`${this.message}; restart begins another run`);
    if (this.system.isOver) throw new Refused(OVER);
  }

  private anchor(): void {
    this.wall = performance.now();
    this.tick = this.system.tick;
    this.behind = 0;
  }

  /** The session's files by their paths, as a run's folder has them. */
  private journal(): Record<string, string> {
    const { columns, head, files } = this.data;
    const row = this.system.row();
    const seen = Object.fromEntries(columns.flatMap((name, i) => (/^plant\.qpos\b/.test(name) ? [[name, row[i]]] : [])));
    const { tick } = this.system;
    const end = this.actions.at(-1)?.action === "end" ? [] : [{ tick, action: "end", reason: "downloaded from a page" }];
    const lines = [{ ...head, seen }, ...this.actions, ...end].map((line) => `${JSON.stringify(line)}\n`);
    return { "session.jsonl": lines.join(""), ...Object.fromEntries(Object.entries(files).map(([name, text]) => [`scenario/${name}`, text])) };
  }

  private say(message: object): void {
    this.tell(JSON.stringify(message));
  }

  private show(): void {
    if (!this.failed) this.tell(this.system.row());
  }

  private tellStatus(): void {
    const { run, playing, speed, coupling, values, message } = this;
    const over = this.system.isOver && !this.failed;
    const status: Status = { run, playing, over, speed, coupling, values, behind: this.behind / 1000, folder: "", message, acts: true };
    this.say({ status });
  }

  private tellPlan(): void {
    const { data, system } = this;
    const { times, positions } = system.trajectory;
    const [first, last] = [times[0], times[times.length - 1]];
    const isCurved = data.trajectory.interpolation === "spline";
    const time = isCurved ? Array.from({ length: POINTS }, (_, i) => first + (i / (POINTS - 1)) * (last - first)) : [...times];
    const points = isCurved ? time.flatMap((t) => system.trajectory.sample(t).slice(0, 3)) : positions.flat();
    const waypoints = data.plan.waypoints.map((mark, i) => ({ ...mark, place: positions[i] as [number, number, number] }));
    const plan: Plan = { time, points, waypoints };
    this.say({ plan });
  }
}

const isOf = (name: string, scalar: string): boolean => scalar === name || scalar.replace(/\[.*/, "") === name;

/** Return a parameter's value as FMI has it. */
function numberOf({ name, kind, choices, minimum, maximum }: Tunable, value: Value): number {
  const number = kind === "Enumeration" ? choices.indexOf(String(value)) + 1 : Number(value);
  const [low, high] = kind === "Enumeration" ? [1, choices.length] : [minimum ?? -Infinity, maximum ?? Infinity];
  if (!(number >= low && number <= high)) throw new Refused(`${name}: value ${value}; must be ${choices.length ? choices.join(", ") : `from ${low} to ${high}`}`);
  return number;
}
