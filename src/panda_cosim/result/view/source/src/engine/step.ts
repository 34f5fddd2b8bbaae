// The master's step in the words of the Python one: from the values at t_k to those at t_k+1.
//
// Gauss-Seidel: a slave that feeds a later one is a leader, such as the controller, which feeds the
// plant. Its outputs act within the same step. The other slaves are followers.
// Jacobi: there are no leaders, so all outputs act one step later.
import { SimulationError, type Slave } from "./slave.ts";

export class Step {
  /** Columns of the leaders' outputs, which belong to the row at which a step begins. */
  readonly leaderColumns: readonly number[];
  private readonly leaders: readonly Slave[];
  private readonly followers: readonly Slave[];
  private readonly fedBack: readonly number[];

  constructor(
    slaves: readonly Slave[], // in the order of stepping
    coupling: string,
    private readonly size: number, // [s]
    private readonly columns: readonly string[], // of a row, for messages
  ) {
    this.leaders = coupling === "gauss-seidel" ? leaders(slaves) : [];
    this.followers = slaves.filter((slave) => !this.leaders.includes(slave));
    this.leaderColumns = this.leaders.flatMap(({ outputs }) => outputs);
    this.fedBack = feedingBack(this.leaders).flatMap(({ outputs }) => outputs);
  }

  /** Step from a row, which has the external inputs and the followers' outputs, to the next. */
  take(row: Float64Array, next: Float64Array): void {
    const [time] = row;
    this.lead(row);
    for (const follower of this.followers) follower.setInputs(row);
    for (const follower of this.followers) follower.step(time, this.size);
    for (const follower of this.followers) follower.getOutputs(next);
    for (const column of this.fedBack) next[column] = row[column];
  }

  /** Let the leaders step, which completes the row; also the last one. */
  lead(row: Float64Array): void {
    for (const leader of this.leaders) {
      leader.setInputs(row);
      leader.step(row[0], this.size);
      leader.getOutputs(row);
    }
    const wrong = row.findIndex((value) => !Number.isFinite(value));
    if (wrong >= 0) throw new SimulationError(`${this.columns[wrong]}: value ${row[wrong]} is not finite`);
  }
}

/** Exchange values at the start: once for each slave, so that they reach the last one. */
export function initialize(slaves: readonly Slave[], row: Float64Array): void {
  const feeding = slaves.filter((slave) => slaves.some((other) => slave.feeds(other)));
  for (const slave of slaves) slave.enterInitialization();
  for (const slave of feeding) slave.getOutputs(row);
  for (let count = 0; count < slaves.length; count++) {
    for (const slave of slaves) {
      slave.setInputs(row);
      if (feeding.includes(slave)) slave.getOutputs(row);
    }
  }
  for (const slave of slaves) slave.exitInitialization();
  for (const slave of slaves) slave.getOutputs(row);
}

/** Slaves that feed a later one. */
function leaders(slaves: readonly Slave[]): Slave[] {
  return slaves.filter((slave, i) => slaves.slice(i + 1).some((later) => slave.feeds(later)));
}

/** Leaders that feed themselves or an earlier leader. */
function feedingBack(chosen: readonly Slave[]): Slave[] {
  return chosen.filter((leader, i) => chosen.slice(0, i + 1).some((earlier) => leader.feeds(earlier)));
}
