// The picture: renderer, lights, figures, layers. It is drawn only when something has changed.
import {
  DirectionalLight,
  HemisphereLight,
  NeutralToneMapping,
  PCFShadowMap,
  PerspectiveCamera,
  PMREMGenerator,
  Scene,
  type Texture,
  WebGLRenderer,
} from "three";
import type { RunSource } from "../data/source.ts";
import { make } from "../dom.ts";
import { environment } from "./environment.ts";
import { Figure } from "./figure.ts";
import { Labels, marksByPlace } from "./labels.ts";
import { type Quality, quality } from "./quality.ts";
import { actualPath, COLOURS, commandedPath, forces, frames, type Layer, waypoints } from "./overlays.ts";
import { Viewpoint } from "./viewpoint.ts";

/** Events of the scene that the page handles. */
export interface StageActs {
  looked(): void;
  seek(time: number): void;
}

interface Actor {
  run: RunSource;
  figure: Figure;
  qpos: Float64Array;
}

export class Stage {
  readonly element = make("div", "pv-stage");
  readonly scene = new Scene();
  readonly layers: Layer[] = [];
  readonly labels = new Labels();
  readonly viewpoint: Viewpoint;
  /** Frames drawn so far. */
  drawn = 0;
  private readonly renderer: WebGLRenderer;
  readonly camera = new PerspectiveCamera(45, 1, 0.02, 60);
  private readonly sun = new DirectionalLight(0xffffff, 2.1);
  private readonly fill = new DirectionalLight(0xffffff, 0.6);
  private readonly sky = new HemisphereLight(0xffffff, 0xc9ced8, 0.55);
  private readonly sizes: ResizeObserver;
  private frame = 0;
  private time = 0;

  private constructor(
    private readonly actors: Actor[],
    private readonly acts: StageActs,
    private readonly quality: Quality,
  ) {
    this.renderer = new WebGLRenderer({ antialias: quality.antialias, alpha: true, powerPreference: "high-performance" });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, quality.pixelRatio));
    this.renderer.toneMapping = NeutralToneMapping;
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = PCFShadowMap;
    this.renderer.shadowMap.autoUpdate = false;
    this.scene.environment = quality.reflections ? this.reflect() : null;
    this.light();
    const canvas = this.renderer.domElement;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "The run in 3D; drag to rotate the view");
    this.element.append(canvas, this.labels.element);
    const { model, bodies } = actors[0].figure;
    this.camera.up.set(0, 0, 1);
    this.viewpoint = new Viewpoint(this.camera, canvas, model, bodies, () => {
      this.acts.looked();
      this.refresh();
    });
    this.dress();
    this.sizes = new ResizeObserver(() => this.resize());
    this.sizes.observe(this.element);
  }

  /** Build the scene of a run, and of another one as its ghost if that has a model, too. */
  static async build(runs: readonly RunSource[], acts: StageActs): Promise<Stage> {
    const chosen = quality();
    const drawn = runs.flatMap((run, index) => (run.model ? [{ run, model: run.model, isGhost: index > 0 }] : []));
    const actors = drawn.map(async ({ run, model, isGhost }) => ({
      run,
      figure: await Figure.build(model, { isGhost, anisotropy: chosen.anisotropy }),
      qpos: new Float64Array(model.nq),
    }));
    return new Stage(await Promise.all(actors), acts, chosen);
  }

  /** The figures in the scene, the run's first. */
  get figures(): Figure[] {
    return this.actors.map(({ figure }) => figure);
  }

  /** Whether nothing is waiting to be drawn. */
  get idle(): boolean {
    return this.frame === 0;
  }

  /** Show an instant [s]. */
  show(time: number): void {
    this.time = time;
    for (const { run, figure, qpos } of this.actors) {
      run.pose(time, qpos);
      figure.pose(qpos);
    }
    for (const layer of this.layers) if (layer.object.visible) layer.update(time);
    this.renderer.shadowMap.needsUpdate = true;
    this.refresh();
  }

  /** Show or hide a layer. */
  toggle(layer: Layer, visible: boolean): void {
    layer.object.visible = visible;
    if (layer.key === "waypoints") this.labels.element.hidden = !visible;
    this.show(this.time);
  }

  /** Redraw the commanded path and the waypoints after a change. */
  replan(): void {
    const [{ run }] = this.actors;
    for (const made of [commandedPath(run), waypoints(run)]) {
      const old = this.layers.find(({ key }) => key === made?.key);
      if (!made || !old) continue;
      made.object.visible = old.object.visible;
      this.scene.remove(old.object);
      this.scene.add(made.object);
      Object.assign(old, made); // its checkbox keeps the same object
    }
    this.name(run);
    this.show(this.time);
  }

  /** Apply the page's colour scheme. */
  set dark(isDark: boolean) {
    for (const figure of this.figures) figure.dark = isDark;
    const plain = this.quality.reflections ? 0 : 1; // replaces the light of missing reflections
    this.sun.intensity = isDark ? 1.7 : 2.1;
    this.fill.intensity = (isDark ? 0.35 : 0.6) + 0.35 * plain;
    this.sky.intensity = (isDark ? 0.3 : 0.7) + (isDark ? 0.7 : 1.15) * plain;
    this.scene.environmentIntensity = isDark ? 0.42 : 0.62;
    this.refresh();
  }

  /** Draw in the next animation frame. */
  refresh(): void {
    this.frame ||= requestAnimationFrame((now) => this.draw(now));
  }

  dispose(): void {
    cancelAnimationFrame(this.frame);
    this.frame = -1; // disables drawing
    this.sizes.disconnect();
    this.viewpoint.dispose();
    this.scene.environment?.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  /** Make the environment map for reflections. */
  private reflect(): Texture {
    const maker = new PMREMGenerator(this.renderer);
    const { texture } = maker.fromScene(environment(), 0.03, 0.1, 20, { size: 64 });
    maker.dispose();
    return texture;
  }

  private light(): void {
    const { model } = this.actors[0].figure;
    const [x, y] = model.center;
    const reach = 1.15 * model.extent;
    this.sun.position.set(x - 0.45 * reach, y - 1.25 * reach, 2.3 * reach);
    this.sun.target.position.set(x, y, 0.2 * reach);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.setScalar(this.quality.shadowSide);
    this.sun.shadow.radius = 3.5;
    this.sun.shadow.intensity = 0.82;
    this.sun.shadow.normalBias = 0.004 * model.extent;
    Object.assign(this.sun.shadow.camera, { left: -reach, right: reach, top: reach, bottom: -reach, near: 0.1, far: 6 * reach });
    this.fill.position.set(x + 2 * reach, y - 0.6 * reach, 0.8 * reach);
    this.fill.target.position.copy(this.sun.target.position);
    this.sky.position.set(0, 0, 1);
    this.scene.add(this.sun, this.sun.target, this.fill, this.fill.target, this.sky);
  }

  private dress(): void {
    const [first, ghost] = this.actors;
    const add = (layer: Layer | null) => {
      if (!layer) return;
      this.layers.push(layer);
      this.scene.add(layer.object);
    };
    for (const { figure } of this.actors) this.scene.add(figure.root);
    add(commandedPath(first.run));
    add(actualPath(first.run, COLOURS.actual));
    add(frames(first.run));
    add(forces(first.run));
    add(waypoints(first.run));
    this.name(first.run);
    if (ghost) {
      const path = actualPath(ghost.run, COLOURS.ghost);
      if (path) ghost.figure.root.add(path.object);
      add({ name: `ghost: ${ghost.run.name}`, key: "ghost", object: ghost.figure.root, update: (time) => path?.update(time) });
    }
  }

  private name(run: RunSource): void {
    this.labels.clear();
    for (const { place, marks } of marksByPlace(run)) {
      const next = () => marks.find(({ time }) => time > this.time + 1e-6) ?? marks[0];
      const hint = marks.map(({ label, time }) => `waypoint ${label} at ${time.toFixed(2)} s`).join(", ");
      this.labels.add(marks.map(({ label }) => label).join("/"), place, hint, () => this.acts.seek(next().time));
    }
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    this.renderer.setSize(width, height, false);
    this.viewpoint.resize(width / height);
    this.draw(performance.now());
  }

  private draw(now: number): void {
    if (this.frame < 0) return;
    cancelAnimationFrame(this.frame);
    this.frame = 0;
    const moves = this.viewpoint.update(now);
    this.renderer.render(this.scene, this.camera);
    const { clientWidth, clientHeight } = this.element;
    this.labels.update(this.camera, clientWidth, clientHeight);
    this.drawn++;
    if (moves) this.refresh();
  }
}
