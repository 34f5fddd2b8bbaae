// The coupled system of a page: its FMUs, their rows, and the inputs that the scenario gives them.
import type { Tunable } from "../live/link.ts";
import { type CriterionData, Judge } from "./judge.ts";
import { MuJoCo } from "./mujoco.ts";
import { Slave, type SlaveData } from "./slave.ts";
import { initialize, Step } from "./step.ts";
import { Trajectory, type TrajectoryData } from "./trajectory.ts";

/** What src/panda_cosim/study/live/alone.py writes of a prepared run. */
export interface SystemData {
  slaves: SlaveData[]; // in the order of stepping
  coupling: string;
  step: number; // [s]
  ticks: number; // to the end
  columns: string[]; // of a row: time, external inputs, outputs
  external: number[]; // external inputs at the start
  trajectory: TrajectoryData;
  commands: number[]; // column of each of the trajectory's values, or -1
  pushes: { start: number; duration: number; force: number[]; columns: number[] }[];
  criteria: CriterionData[];
}

/** Compiled modules by name; MuJoCo's is `mujoco`. */
export type Modules = Record<string, WebAssembly.Module>;

const BLOCK = 3 << 20; // [B] of MuJoCo's memory, in which data and stacks of the FMUs lie

export class System {
  tick = 0;
  trajectory!: Trajectory;
  judge!: Judge;
  readonly held = new Map<number, number>(); // values of external inputs by column
  private now: Float64Array;
  private next: Float64Array;
  private step!: Step;

  private constructor(
    private readonly data: SystemData,
    private readonly slaves: readonly Slave[],
  ) {
    [this.now, this.next] = [0, 1].map(() => new Float64Array(data.columns.length));
    this.prepare();
  }

  /** Open the FMUs; nothing is initialized yet. */
  static async open(data: SystemData, modules: Modules): Promise<System> {
    const engine = await MuJoCo.start(modules.mujoco);
    const place = engine.block(BLOCK); // first, so that it is where the FMUs were linked for
    const slaves: Slave[] = [];
    for (const slave of data.slaves) slaves.push(await Slave.open(engine, modules[slave.name], [place, place + BLOCK], slave));
    return new System(data, slaves);
  }

  get isOver(): boolean {
    return this.tick >= this.data.ticks;
  }

  get time(): number {
    return this.tick * this.data.step;
  }

  /** Begin a run at t = 0. */
  begin(): void {
    this.slaves.forEach((slave) => slave.reset());
    this.tick = 0;
    this.held.clear();
    this.prepare();
    this.now.fill(0);
    this.putInputs(this.now);
    initialize(this.slaves, this.now);
  }

  /** Take some steps, or fewer at the end; then all values of the row are known but the leaders', which are held. */
  advance(count: number): void {
    for (; count > 0 && !this.isOver; count--) {
      this.putInputs(this.now);
      this.step.take(this.now, this.next);
      this.judge.see(this.now);
      [this.now, this.next] = [this.next, this.now];
      this.tick++;
      this.now[0] = this.time;
    }
    for (const column of this.step.leaderColumns) this.now[column] = this.next[column];
    this.putInputs(this.now);
    if (!this.isOver) return;
    this.step.lead(this.now);
    this.judge.see(this.now);
  }

  /** The present row; inputs are those of the next step. */
  row(): Float64Array {
    this.putInputs(this.now);
    return this.now.slice();
  }

  couple(coupling: string): void {
    this.step = new Step(this.slaves, coupling, this.data.step, this.data.columns);
  }

  set(tunable: Tunable, value: number): void {
    this.slaves.find(({ data }) => tunable.name.startsWith(`${data.name}.`))!.set(tunable, value);
  }

  private prepare(): void {
    this.trajectory = new Trajectory(this.data.trajectory);
    this.judge = new Judge(this.data.criteria);
    this.couple(this.data.coupling);
  }

  /** Set time and external inputs: what the scenario gives, then what is held instead. */
  private putInputs(row: Float64Array): void {
    const { external, commands, pushes, step } = this.data;
    row.set(external, 1);
    for (const { start, duration, force, columns } of pushes) {
      const isActive = this.time >= start - step / 2 && this.time < start + duration - step / 2;
      if (isActive) force.forEach((newton, i) => (row[columns[i]] += newton));
    }
    this.trajectory.sample(this.time).forEach((value, i) => {
      if (commands[i] >= 0) row[commands[i]] = value;
    });
    for (const [column, value] of this.held) row[column] = value;
  }
}
