// What acts on a simulation that goes on: pause, step, speed, restart, coupling, parameters.
import { button, make, number } from "../dom.ts";
import type { Command, Status, Tunable } from "./link.ts";

const SPEEDS = [0.05, 0.1, 0.25, 0.5, 1, 2, 4];
const REACH = 4; // a slider goes up to this many times the value at the start, at most

type Send = (command: Command) => void;

/** The bar below the picture. */
export class Bar {
  readonly element: HTMLElement;
  private readonly play: HTMLButtonElement;
  private readonly speed = make("select", "pv-speed");
  private readonly clock = make("output", "pv-clock");
  private readonly says = make("output", "pv-says");
  private playing = false;

  constructor(private readonly send: Send) {
    this.play = button("Run or pause (space)", "pv-text pv-run", () => this.toggle(), "Run");
    this.speed.setAttribute("aria-label", "Speed");
    for (const factor of SPEEDS) this.speed.append(new Option(`${factor}×`, String(factor)));
    this.speed.addEventListener("change", () => send({ do: "speed", factor: Number(this.speed.value) }));
    const step = button("One tick on (.)", "pv-text pv-tick-on", () => this.step(), "1 tick");
    const restart = button("Begin another run", "pv-text pv-restart", () => send({ do: "restart" }), "Restart");
    this.element = make("footer", "pv-transport pv-live", this.play, step, restart, this.clock, this.speed, this.says);
  }

  toggle(): void {
    this.send({ do: this.playing ? "pause" : "play" });
  }

  step(): void {
    this.send({ do: "step", ticks: 1 });
  }

  /** Go to the next speed, or to the one before. */
  changeSpeed(by: number): void {
    const factor = SPEEDS[SPEEDS.indexOf(Number(this.speed.value)) + by];
    if (factor !== undefined) this.send({ do: "speed", factor });
  }

  show(status: Status): void {
    this.playing = status.playing;
    this.play.textContent = status.playing ? "Pause" : "Run";
    this.speed.value = String(status.speed);
    if (!this.speed.value) this.speed.add(new Option(`${status.speed}×`, String(status.speed), false, true));
    const late = status.behind > 0.1 ? `${status.behind.toFixed(1)} s behind real time` : "";
    this.say([status.acts ? "" : "another page acts; this one looks on", status.message, late].filter(Boolean).join(" · "));
    for (const control of this.element.querySelectorAll("button, select")) control.toggleAttribute("disabled", !status.acts);
  }

  showTime(time: number): void {
    this.clock.textContent = `${time.toFixed(3)} s`;
  }

  say(words: string): void {
    this.says.textContent = words;
  }
}

/** The panel beside the picture: coupling and tunable parameters. */
export class Parameters {
  readonly element = make("div", "pv-facts pv-parameters");
  private readonly rows: { tunable: Tunable; slider: HTMLInputElement; field: HTMLInputElement }[] = [];
  private readonly coupling = make("select", "pv-coupling");

  constructor(
    private readonly send: Send,
    tunables: readonly Tunable[],
    couplings: readonly string[],
  ) {
    for (const name of couplings) this.coupling.append(new Option(name, name));
    this.coupling.addEventListener("change", () => send({ do: "coupling", coupling: this.coupling.value }));
    this.element.append(make("label", "pv-parameter", make("span", "pv-what", "coupling"), this.coupling));
    const groups = new Map<string, Tunable[]>();
    for (const tunable of tunables) {
      const name = tunable.name.replace(/\[.*/, "");
      groups.set(name, [...(groups.get(name) ?? []), tunable]);
    }
    for (const [name, group] of groups) {
      const words = make("summary", "", make("code", "", name), ` ${group[0].unit === "1" ? "" : group[0].unit}`);
      words.title = group[0].words;
      const box = make("details", "", words, ...group.map((tunable) => this.row(tunable)));
      box.open = name === "controller.kp";
      this.element.append(box);
    }
  }

  show({ values, coupling, acts }: Status): void {
    this.coupling.value = coupling;
    for (const { tunable, slider, field } of this.rows) {
      const value = values[tunable.name];
      if (!slider.max) this.fit(tunable, slider, value);
      if (document.activeElement !== slider) slider.value = String(value);
      if (document.activeElement !== field) field.value = String(Number(value.toPrecision(8)));
    }
    for (const control of this.element.querySelectorAll("input, select")) control.toggleAttribute("disabled", !acts);
  }

  /** Give a slider a useful reach; the field beside it takes the whole range. */
  private fit({ minimum, maximum }: Tunable, slider: HTMLInputElement, value: number): void {
    const reach = Math.max(REACH * Math.abs(value), 1e-3);
    slider.min = String(Math.max(minimum ?? -reach, value - reach));
    slider.max = String(Math.min(maximum ?? reach, value + reach));
    slider.step = "any";
  }

  private row(tunable: Tunable): HTMLElement {
    const { name, unit, minimum, maximum, words } = tunable;
    const slider = make("input", "pv-slider");
    slider.type = "range";
    const field = make("input", "pv-field");
    field.type = "number";
    field.step = "any";
    if (minimum !== null) field.min = String(minimum);
    if (maximum !== null) field.max = String(maximum);
    slider.dataset.name = name;
    slider.setAttribute("aria-label", name);
    field.setAttribute("aria-label", `${name} ${unit}`);
    const set = (value: string) => value !== "" && this.send({ do: "set", name, value: Number(value) });
    slider.addEventListener("input", () => (field.value = number(Number(slider.value)).replace("−", "-")));
    slider.addEventListener("change", () => set(slider.value));
    field.addEventListener("change", () => set(field.value));
    this.rows.push({ tunable, slider, field });
    const range = minimum !== null && maximum !== null ? `${number(minimum)} to ${number(maximum)}` : "";
    const row = make("label", "pv-parameter", make("span", "pv-what", name.replace(/^[^[]*/, "") || "value"), slider, field);
    row.title = [words, [range, unit === "1" ? "" : unit].join(" ").trim()].filter(Boolean).join("; ");
    return row;
  }
}
