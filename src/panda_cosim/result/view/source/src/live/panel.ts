// Controls of a live simulation: pause, step, speed, restart, coupling, parameters.
import { button, hint, joined, legible, make, number, option } from "../dom.ts";
import type { Command, Status, Tunable, Value } from "./link.ts";

const SPEEDS = [0.05, 0.1, 0.25, 0.5, 1, 2, 4];
const JOURNAL = "Download the scenario and the journal of your actions; panda-cosim replay repeats them";
const END = 1500; // [ms] for which the end of a run is seen
const REACH = 4; // a slider spans at most this multiple of the start value

type Send = (command: Command) => void;

/** The bar below the picture. */
export class Bar {
  readonly element: HTMLElement;
  private readonly play: HTMLButtonElement;
  private readonly speed = make("select", "pv-speed");
  private readonly clock = make("output", "pv-clock");
  private readonly says = make("output", "pv-says");
  private readonly again = make("input", "pv-switch");
  private playing = false;
  private ended = 0; // number of the last run that was begun again

  constructor(
    private readonly send: Send,
    isAlone: boolean, // without a server, which keeps scenarios and journals
    private readonly changes: () => Command[], // what was changed, and is changed again in the next run
  ) {
    this.play = button("Run or pause (space)", "pv-text pv-run", () => this.toggle(), "Run");
    this.speed.setAttribute("aria-label", "Speed");
    for (const factor of SPEEDS) this.speed.append(option(String(factor), `${factor}×`));
    this.speed.addEventListener("change", () => send({ do: "speed", factor: Number(this.speed.value) }));
    const step = button("One step forward (.)", "pv-text pv-tick-on", () => this.step(), "1 tick");
    const restart = button("Start a new run from t = 0, with the scenario's values", "pv-text pv-restart", () => send({ do: "restart" }), "Restart");
    const actions = make("span", "pv-actions", ...(isAlone ? [this.written()] : [this.keeper(), this.kept()]));
    this.again.type = "checkbox";
    this.again.checked = isAlone; // a server keeps a folder for each run
    const repeat = make("label", "pv-again", this.again, "repeat");
    hint(repeat, "Begin again at the end, with the parameters as they are");
    this.element = make("footer", "pv-transport pv-live", this.play, step, restart, this.clock, this.speed, repeat, this.says, actions);
  }

  /** A link to the journal that the server keeps. */
  private kept(): HTMLElement {
    const journal = make("a", "pv-text pv-journal", "Journal");
    journal.href = `session.zip${location.search}`; // with the token
    journal.download = "session.zip";
    journal.title = JOURNAL;
    return journal;
  }

  /** A button that asks the page's own simulation for the journal. */
  private written(): HTMLElement {
    return button(JOURNAL, "pv-text pv-journal", () => this.send({ do: "journal" }), "Journal");
  }

  /** A button that asks for a name, and saves the session as a scenario. */
  private keeper(): HTMLElement {
    const name = make("input", "pv-field pv-keep-name");
    name.type = "text";
    name.required = true;
    name.pattern = "[A-Za-z0-9][A-Za-z0-9_\\-]{0,63}";
    name.placeholder = "name";
    name.setAttribute("aria-label", "Name of the scenario");
    name.title = "Letters, digits, - and _";
    const keep = make("button", "pv-text", "Keep");
    const form = make("form", "pv-keep", name, keep);
    form.hidden = true;
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.send({ do: "keep", name: name.value });
      form.hidden = true;
    });
    const open = button("Save the session up to now as a scenario", "pv-text pv-keep-open", () => {
      form.hidden = !form.hidden;
      if (!form.hidden) name.focus();
    }, "Keep as scenario");
    return make("span", "pv-keeper", open, form);
  }

  toggle(): void {
    this.send({ do: this.playing ? "pause" : "play" });
  }

  step(): void {
    this.send({ do: "step", ticks: 1 });
  }

  /** Choose the next or the previous speed. */
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
    this.say(status.acts ? "" : "view only: another page has control", status.message, late);
    for (const control of this.element.querySelectorAll("button, select")) control.toggleAttribute("disabled", !status.acts);
    if (status.over && status.acts && this.again.checked && this.ended !== status.run) this.beginAgain(status.run);
  }

  /** Begin another run after a moment, in which the end is seen. */
  private beginAgain(run: number): void {
    this.ended = run;
    setTimeout(() => {
      if (!this.again.checked) return void (this.ended = 0);
      const changes = this.changes();
      for (const command of [{ do: "restart" } as const, ...changes, { do: "play" } as const]) this.send(command);
    }, END);
  }

  showTime(time: number): void {
    this.clock.textContent = `${time.toFixed(3)} s`;
  }

  say(...words: string[]): void {
    this.says.replaceChildren(...joined(words));
  }
}

/** The panel beside the picture: coupling and tunable parameters. */
export class Parameters {
  readonly element = make("div", "pv-facts pv-parameters");
  private readonly rows: { tunable: Tunable; show(value: Value): void }[] = [];
  private readonly coupling = make("select", "pv-coupling");
  private first = ""; // coupling
  private now: Status | null = null;

  constructor(
    private readonly send: Send,
    private readonly tunables: readonly Tunable[],
    couplings: readonly string[],
  ) {
    for (const name of couplings) this.coupling.append(option(name));
    this.coupling.addEventListener("change", () => send({ do: "set_coupling", coupling: this.coupling.value }));
    this.element.append(make("label", "pv-parameter", make("span", "pv-what", "coupling"), this.coupling));
    const groups = new Map<string, Tunable[]>();
    for (const tunable of tunables) {
      const name = tunable.name.replace(/\[.*/, "");
      groups.set(name, [...(groups.get(name) ?? []), tunable]);
    }
    for (const [name, group] of groups) {
      const words = make("summary", "", make("code", "", name), " ", make("bdi", "", group[0].unit === "1" ? "" : group[0].unit));
      const each = group.map((tunable) => this.control(tunable));
      const alike = group.length > 1 && group.every(({ kind, unit }) => kind === "Real" && unit === group[0].unit);
      const single = alike ? [this.row(group[0], group), make("details", "", make("summary", "", `each of the ${group.length}`), ...each)] : each;
      const box = make("details", "", words, make("p", "pv-words", group[0].words), ...single);
      box.open = name === "controller.kp";
      this.element.append(box);
    }
  }

  /** Return commands that change what now differs from the start. */
  changes(): Command[] {
    if (!this.now) return [];
    const { values, coupling } = this.now;
    const changed = this.tunables.filter(({ name, start }) => values[name] !== start);
    const sets = changed.map(({ name }): Command => ({ do: "set", name, value: values[name] }));
    return coupling === this.first ? sets : [...sets, { do: "set_coupling", coupling }];
  }

  show(status: Status): void {
    const { values, coupling, acts } = status;
    this.now = status;
    this.first ||= coupling;
    this.coupling.value = coupling;
    for (const { tunable, show } of this.rows) show(values[tunable.name]);
    for (const control of this.element.querySelectorAll("input, select, button")) control.toggleAttribute("disabled", !acts);
  }

  /** Give a slider a useful range; the field beside it takes the whole range. */
  private fit({ minimum, maximum }: Tunable, slider: HTMLInputElement, value: number): void {
    const reach = Math.max(REACH * Math.abs(value), 1e-3);
    slider.min = String(Math.max(minimum ?? -reach, value - reach));
    slider.max = String(Math.min(maximum ?? reach, value + reach));
    slider.step = "any";
  }

  private control(tunable: Tunable): HTMLElement {
    if (tunable.kind === "Boolean") return this.tick(tunable);
    return tunable.choices.length ? this.choice(tunable) : this.row(tunable);
  }

  private tick(tunable: Tunable): HTMLElement {
    const box = make("input", "pv-switch");
    box.type = "checkbox";
    box.addEventListener("change", () => this.send({ do: "set", name: tunable.name, value: box.checked }));
    return this.named(tunable, box, (value) => (box.checked = Boolean(value)));
  }

  private choice(tunable: Tunable): HTMLElement {
    const list = make("select", "pv-coupling", ...tunable.choices.map((choice) => option(choice)));
    list.addEventListener("change", () => this.send({ do: "set", name: tunable.name, value: list.value }));
    return this.named(tunable, list, (value) => (list.value = String(value)));
  }

  private named(tunable: Tunable, control: HTMLElement, show: (value: Value) => void): HTMLElement {
    control.dataset.name = tunable.name;
    const place = tunable.name.replace(/^[^[]*/, "") || "value";
    return make("label", "pv-parameter", make("span", "pv-what", place), control, this.reset(tunable, [tunable], show));
  }

  /** A button that sets parameters to what they are at the start; what shows the value tells it, too. */
  private reset(tunable: Tunable, group: readonly Tunable[], show: (value: Value) => void): HTMLElement {
    const { start } = tunable;
    const name = group.length > 1 ? tunable.name.replace(/\[.*/, "") : tunable.name;
    const value = group.length > 1 ? group.map((each) => Number(each.start)) : start;
    const words = typeof start === "number" ? number(start) : String(start);
    const back = button(`Back to ${words}`, "pv-reset", () => this.send({ do: "set", name, value }), "↺");
    this.rows.push({ tunable, show: (now) => (show(now), back.toggleAttribute("hidden", now === start)) });
    return back;
  }

  /** A slider and a field for a number, or for all elements of a group at once. */
  private row(tunable: Tunable, group: readonly Tunable[] = []): HTMLElement {
    const { unit, minimum, maximum, words } = tunable;
    const name = group.length ? tunable.name.replace(/\[.*/, "") : tunable.name;
    const slider = make("input", "pv-slider");
    slider.type = "range";
    const field = make("input", "pv-field");
    field.type = "number";
    field.step = "any";
    if (minimum !== null) field.min = String(minimum);
    if (maximum !== null) field.max = String(maximum);
    slider.dataset.name = name;
    slider.setAttribute("aria-label", legible(name));
    field.setAttribute("aria-label", legible(`${name} ${unit}`));
    const set = (value: string) => value !== "" && this.send({ do: "set", name, value: Number(value) });
    slider.addEventListener("input", () => (field.value = number(Number(slider.value)).replace("−", "-")));
    slider.addEventListener("change", () => set(slider.value));
    field.addEventListener("change", () => set(field.value));
    const show = (given: Value) => {
      const value = Number(given);
      if (!slider.max) this.fit(tunable, slider, value);
      if (document.activeElement !== slider) slider.value = String(value);
      if (document.activeElement !== field) field.value = String(Number(value.toPrecision(8)));
    };
    const place = group.length ? "all" : name.replace(/^[^[]*/, "") || "value";
    const range = minimum !== null && maximum !== null ? `${number(minimum)} to ${number(maximum)}` : "";
    const row = make("label", "pv-parameter", make("span", "pv-what", place), slider, field, this.reset(tunable, group.length ? group : [tunable], show));
    const about = [words, [range, unit === "1" ? "" : unit].join(" ").trim(), `at the start ${number(Number(tunable.start))}`];
    hint(row, about.filter(Boolean).join("; "));
    return row;
  }
}
