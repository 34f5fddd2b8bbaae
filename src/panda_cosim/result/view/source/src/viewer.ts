// The viewer of one run, or of a run and its ghost. It owns the clock, the stage and the panels.
import { keepAddress, type Place, readAddress } from "./address.ts";
import { Clock, SPEEDS } from "./clock.ts";
import type { RunSource } from "./data/source.ts";
import { make } from "./dom.ts";
import { help, type Key, listen } from "./keys.ts";
import { Curves } from "./panels/curves.ts";
import { facts } from "./panels/facts.ts";
import { header } from "./panels/header.ts";
import { Hud } from "./panels/hud.ts";
import { transport } from "./panels/transport.ts";
import { Stage } from "./scene/stage.ts";
import { isDark, onScheme } from "./scheme.ts";

const TURN = 0.12; // [rad] per key press
const NEARER = 0.88; // factor on the distance per key press

/** What the live page adds to a viewer, or replaces. */
export interface Extras {
  footer: HTMLElement;
  panel: [string, HTMLElement];
  keys: Key[];
}

export class Viewer {
  readonly clock: Clock;
  stage: Stage | null = null;
  readonly curves: Curves;
  private hud: Hud | null = null;
  private readonly root = make("div", "pv");
  private readonly picture = make("div", "pv-picture");
  private readonly keys: Key[];
  private readonly help: HTMLDialogElement;
  private readonly stops: (() => void)[] = [];
  private forced: boolean | null = null;

  private constructor(
    private readonly runs: readonly RunSource[],
    private readonly into: HTMLElement,
    private readonly ownsAddress: boolean,
    private readonly extras: Extras | null,
  ) {
    const [run, ghost = null] = runs;
    this.keys = this.listKeys();
    this.help = help(this.keys);
    this.clock = new Clock(run.span[0], run.span[1], run.tick);
    this.curves = new Curves(run, ghost, this.clock);
    const side = make("aside", "pv-side", this.tabs(this.curves.element, facts(run.about, ghost?.about ?? null)));
    const head = header(run, ghost, () => this.switchScheme());
    this.root.append(make("div", "pv-frame", head, this.picture, side, extras?.footer ?? transport(this.clock, run.about.moments)), this.help);
    this.into.replaceChildren(this.root);
  }

  /** Show a run in an element, and a second one as its ghost. */
  static async open(runs: readonly RunSource[], into: HTMLElement, place: Place, ownsAddress: boolean, extras: Extras | null = null): Promise<Viewer> {
    const viewer = new Viewer(runs, into, ownsAddress, extras);
    viewer.paint();
    await viewer.openStage();
    viewer.go({ camera: viewer.stage?.viewpoint.names[0], at: viewer.clock.span[0] });
    viewer.go(place);
    viewer.link();
    await viewer.curves.open();
    return viewer;
  }

  /** Go to an instant and a camera. */
  go({ at, camera }: Place): void {
    if (camera !== undefined) this.stage?.viewpoint.look(camera, false);
    if (at !== undefined) {
      this.clock.pause();
      this.clock.seek(at);
    }
  }

  close(): void {
    this.clock.pause();
    for (const stop of this.stops) stop();
    this.stage?.dispose();
    this.into.replaceChildren();
  }

  private async openStage(): Promise<void> {
    if (!this.runs[0].model) {
      this.root.dataset.alone = ""; // the curves
      return;
    }
    const address = keepAddress(() => ({ at: this.clock.time, camera: this.stage?.viewpoint.name ?? "" }));
    const tell = () => {
      this.hud?.update();
      if (this.ownsAddress && this.stage && !this.clock.playing) address();
    };
    try {
      this.stage = await Stage.build(this.runs, { looked: tell, seek: (time) => this.clock.seek(time) });
    } catch (error) {
      this.picture.append(make("p", "pv-wait", "The 3D view needs WebGL 2, which this browser does not offer. The curves work without it."));
      console.warn(error);
      return;
    }
    const canFollow = this.runs[0].at("actual", this.clock.time) !== null;
    this.hud = new Hud(this.stage, canFollow ? () => this.follow() : null);
    this.picture.append(this.stage.element, this.hud.element);
    this.clock.onTime((time) => this.stage?.show(time));
    this.clock.onTime(tell);
    this.clock.onState(tell);
    this.paint();
  }

  private link(): void {
    // As part of a larger page, the viewer gets keys only while it has the focus.
    const heard = listen(this.keys, this.ownsAddress ? window : this.root);
    this.stops.push(onScheme(() => this.paint()), heard);
    for (const run of this.runs) this.stops.push(run.onGrowth(() => this.clock.extend(run.span[1])));
    this.stops.push(this.runs[0].onGrowth(() => this.curves.grow()));
    if (!this.ownsAddress) return;
    const onHash = () => this.go(readAddress(location.hash));
    addEventListener("hashchange", onHash);
    this.stops.push(() => removeEventListener("hashchange", onHash));
  }

  private follow(): void {
    const viewpoint = this.stage?.viewpoint;
    viewpoint?.follow(viewpoint.following ? null : () => this.runs[0].at("actual", this.clock.time));
    this.hud?.update();
  }

  private get dark(): boolean {
    return this.forced ?? isDark();
  }

  private switchScheme(): void {
    this.forced = !this.dark;
    this.paint();
  }

  /** Apply the colour scheme. */
  private paint(): void {
    this.root.dataset.scheme = this.dark ? "dark" : "light";
    if (this.stage) this.stage.dark = this.dark;
    this.curves.redraw();
  }

  /** Two panels, one of them visible. */
  private tabs(curves: HTMLElement, about: HTMLElement): HTMLElement {
    const [name, added] = this.extras?.panel ?? ["Verdict", about];
    const panels: Record<string, HTMLElement> = { Curves: curves, [name]: added };
    const bar = make("div", "pv-tabs");
    bar.setAttribute("role", "tablist");
    const choose = (chosen: string) => {
      for (const [name, panel] of Object.entries(panels)) panel.hidden = name !== chosen;
      for (const tab of bar.children) tab.setAttribute("aria-selected", String(tab.textContent === chosen));
    };
    for (const [name, panel] of Object.entries(panels)) {
      const tab = make("button", "pv-tab", name);
      tab.type = "button";
      tab.setAttribute("role", "tab");
      tab.addEventListener("click", () => choose(name));
      panel.setAttribute("role", "tabpanel");
      bar.append(tab);
    }
    choose("Curves");
    return make("div", "pv-panels", bar, curves, added);
  }

  private listKeys(): Key[] {
    const key = (keys: string[], words: string, act: (event: KeyboardEvent) => void): Key => ({ keys, words, act });
    const orbit = (around: number, up: number, nearer = 1) => this.stage?.viewpoint.orbit(around, up, nearer);
    const own = [
      key([" "], "play or pause", () => this.clock.toggle()),
      key([",", "."], "one step back, forward", ({ key: name }) => this.clock.step(name === "," ? -1 : 1)),
      key(["ArrowLeft", "ArrowRight"], "1 % of the run back, forward", ({ key: name }) => this.leap(name === "ArrowLeft" ? -0.01 : 0.01)),
      key(["Home", "End"], "go to the start, the end", ({ key: name }) => this.clock.seek(this.clock.span[name === "Home" ? 0 : 1])),
      key(["[", "]"], "slower, faster", ({ key: name }) => this.changeSpeed(name === "[" ? -1 : 1)),
      key(["1", "2", "3", "4", "5", "6", "7", "8", "9"], "camera", ({ key: name }) => this.lookThrough(Number(name) - 1)),
      key(["f"], "follow the hand", () => this.follow()),
      key(["Shift ArrowLeft", "Shift ArrowRight"], "orbit sideways", ({ key: name }) => orbit(name === "ArrowLeft" ? -TURN : TURN, 0)),
      key(["Shift ArrowUp", "Shift ArrowDown"], "orbit up, down", ({ key: name }) => orbit(0, name === "ArrowUp" ? TURN : -TURN)),
      key(["+", "-"], "zoom in, out", ({ key: name }) => orbit(0, 0, name === "+" ? NEARER : 1 / NEARER)),
      key(["g"], "show or hide the ghost", () => this.toggleLayer("ghost")),
      key(["d"], "light or dark colours", () => this.switchScheme()),
      key(["?"], "this list", () => (this.help.open ? this.help.close() : this.help.show())),
    ];
    const added = this.extras?.keys ?? [];
    const taken = new Set(added.flatMap(({ keys }) => keys));
    return [...added, ...own.filter(({ keys }) => !keys.some((name) => taken.has(name)))];
  }

  private leap(share: number): void {
    const [first, end] = this.clock.span;
    this.clock.seek(this.clock.time + share * (end - first));
  }

  private changeSpeed(by: number): void {
    const index = SPEEDS.indexOf(this.clock.speed) + by;
    if (index >= 0 && index < SPEEDS.length) this.clock.speed = SPEEDS[index];
  }

  private lookThrough(index: number): void {
    const name = this.stage?.viewpoint.names[index];
    if (name !== undefined) this.stage?.viewpoint.look(name);
  }

  private toggleLayer(key: string): void {
    this.root.querySelector<HTMLInputElement>(`input[data-layer="${key}"]`)?.click();
  }
}
