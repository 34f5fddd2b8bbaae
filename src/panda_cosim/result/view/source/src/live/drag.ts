// Pushes bodies with the mouse or a finger, by a spring and damper from the grabbed point to the pointer.
import { ArrowHelper, type Vector2, Vector3 } from "three";
import { make } from "../dom.ts";
import type { Stage } from "../scene/stage.ts";
import { Hold } from "./hold.ts";

const METRES_PER_NEWTON = 0.008;
const INTERVAL = 20; // [ms] between two sent forces
const SAME = 0.02; // [N] smaller changes of the force are not sent
const COLOUR = 0xe5337e;

export interface Push {
  signal: string; // the force, world frame [N]
  bodies: string[]; // bodies that can be grabbed; the force acts on the first
  stiffness: number; // [N/m]
  damping: number; // [N.s/m]
  limit: number; // [N]
}

type Send = (signal: string, force: [number, number, number] | null) => void;

/** A force that is drawn: an arrow from where it acts, with its size. */
class Force {
  private readonly arrow = new ArrowHelper(new Vector3(1, 0, 0), new Vector3(), 0.1, COLOUR, 0.03, 0.02);
  private readonly newtons = make("output", "pv-newtons");

  constructor(stage: Stage) {
    stage.scene.add(this.arrow);
    stage.element.append(this.newtons);
  }

  /** Show a force [N]; `seen` is where a place is in the picture. */
  show(from: Vector3, force: Vector3, seen: (place: Vector3) => Vector2): void {
    const size = force.length();
    this.arrow.visible = size > SAME;
    this.newtons.hidden = !this.arrow.visible;
    if (!this.arrow.visible) return;
    const length = Math.max(size * METRES_PER_NEWTON, 0.04);
    this.arrow.position.copy(from);
    this.arrow.setDirection(force.clone().normalize());
    this.arrow.setLength(length, 0.03, 0.02);
    const tip = seen(force.clone().setLength(length).add(from));
    this.newtons.textContent = `${size.toFixed(1)} N`;
    this.newtons.style.transform = `translate(${tip.x + 10}px, ${tip.y - 10}px)`;
  }
}

export class Drag extends Hold {
  private readonly forces: readonly Force[]; // one for each push
  private push: Push | null = null;
  private readonly grip = new Vector3(); // grabbed point in the body's frame
  private to: Vector3 | null = null;
  private readonly speed = new Vector3(); // of the grabbed point [m/s]
  private readonly before = new Vector3();
  private time = NaN;
  private sent = 0;
  private readonly last = new Vector3();

  constructor(
    stage: Stage,
    private readonly pushes: readonly Push[],
    private readonly send: Send,
    private readonly acting: (signal: string) => number[], // the force now
  ) {
    super(stage);
    this.forces = pushes.map(() => new Force(stage));
  }

  /** Follow the moving body; the stage shows this instant [s]. */
  update(time: number): void {
    for (const push of this.pushes) if (push !== this.push) this.show(push, this.body(push).localToWorld(new Vector3()), new Vector3(...this.acting(push.signal)));
    if (!this.push) return;
    const from = this.from(this.push);
    const passed = time - this.time;
    if (passed > 0) this.speed.copy(from).sub(this.before).divideScalar(passed);
    else this.speed.set(0, 0, 0);
    this.before.copy(from);
    this.time = time;
    this.apply();
  }

  protected take(): Vector3 | null {
    const [figure] = this.stage.figures;
    const [hit] = this.caster.intersectObjects(figure.bodies, true);
    const name = hit?.object.parent?.name ?? "";
    this.push = this.pushes.find(({ bodies }) => bodies.includes(name)) ?? null;
    if (!hit || !this.push) return null;
    this.grip.copy(this.body(this.push).worldToLocal(hit.point.clone()));
    this.speed.set(0, 0, 0);
    this.last.set(0, 0, 0);
    this.time = NaN;
    this.to = null;
    return hit.point;
  }

  protected moveTo(place: Vector3): void {
    this.to = place;
    this.apply();
  }

  protected drop(): void {
    if (this.push && this.sent) this.send(this.push.signal, null);
    this.push = this.to = null;
    this.sent = 0;
  }

  private body(push: Push) {
    return this.stage.figures[0].bodies.find(({ name }) => name === push.bodies[0])!;
  }

  private from(push: Push): Vector3 {
    return this.body(push).localToWorld(this.grip.clone());
  }

  private apply(): void {
    if (!this.push || !this.to) return;
    const { signal, stiffness, damping, limit } = this.push;
    const from = this.from(this.push);
    const force = this.to.clone().sub(from).multiplyScalar(stiffness).addScaledVector(this.speed, -damping);
    force.clampLength(0, limit);
    this.show(this.push, from, force);
    if (performance.now() - this.sent < INTERVAL || (this.sent && force.distanceTo(this.last) < SAME)) return;
    this.sent = performance.now();
    this.last.copy(force);
    this.send(signal, [force.x, force.y, force.z]);
  }

  private show(push: Push, from: Vector3, force: Vector3): void {
    this.forces[this.pushes.indexOf(push)].show(from, force, (place) => this.seen(place));
    this.stage.refresh();
  }
}
