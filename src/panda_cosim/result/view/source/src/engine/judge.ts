// Judges a run by the scenario's simple criteria: a number of each row, reduced over all of them.

/** What src/panda_cosim/study/live/judged.py writes; of a criterion that is not simple, the name alone. */
export interface CriterionData {
  name: string;
  direction: "below" | "above";
  bound: number;
  columns?: [column: number, minus?: number][]; // of a number, or of a vector
  isLength: boolean; // of the vector
  reduce: string;
}

// From the result so far, a value, and how many there are with it.
const FOLDS: Record<string, (result: number, value: number, count: number) => number> = {
  max: (result, value) => Math.max(result, value),
  min: (result, value) => Math.min(result, value),
  final: (_, value) => value,
  rms: (result, value, count) => Math.sqrt(result ** 2 + (value ** 2 - result ** 2) / count),
};

export class Judge {
  private readonly judged: readonly CriterionData[];
  private readonly others: readonly string[];
  private readonly results: number[] = [];
  private count = 0;

  constructor(criteria: readonly CriterionData[]) {
    this.judged = criteria.filter(({ columns }) => columns);
    this.others = criteria.filter(({ columns }) => !columns).map(({ name }) => name);
  }

  /** Take the next row. */
  see(row: Float64Array): void {
    this.count++;
    this.judged.forEach(({ columns, isLength, reduce }, i) => {
      const parts = columns!.map(([column, minus]) => row[column] - (minus === undefined ? 0 : row[minus]));
      const value = isLength ? Math.sqrt(parts.reduce((sum, part) => sum + part * part, 0)) : parts[0];
      this.results[i] = FOLDS[reduce](this.results[i] ?? value, value, this.count);
    });
  }

  /** Say what was missed, how many hold, and what is not judged. */
  get words(): string {
    const missed = this.judged.flatMap(({ name, direction, bound }, i) => {
      const result = this.results[i];
      if (direction === "below" ? result <= bound : result >= bound) return [];
      return [`${name} ${result.toPrecision(3)}, ${direction === "below" ? "allowed" : "required"} ${bound}`];
    });
    const { length } = this.judged;
    const judged = length ? [...missed, `${length - missed.length} of ${length} criteria hold`] : [];
    const others = this.others.length ? [`not judged here: ${this.others.join(", ")}`] : [];
    return [...judged, ...others].map((words) => `; ${words}`).join("");
  }
}
