// Pushes a body with the mouse or a finger: the further it is dragged, the greater the force.
import { ArrowHelper, Plane, Raycaster, Vector2, Vector3 } from "three";
import type { Stage } from "../scene/stage.ts";

const STIFFNESS = 120; // [N/m] from the drag to the force
const METRES_PER_NEWTON = 0.008;
const INTERVAL = 40; // [ms] between two forces that are sent
const COLOUR = 0xe5337e;

export interface Push {
  bodies: string[]; // names of the bodies that can be taken hold of; the force acts on the first
  limit: number; // [N]
  send(force: [number, number, number] | null): void;
}

export class Drag {
  private readonly caster = new Raycaster();
  private readonly plane = new Plane();
  private readonly arrow = new ArrowHelper(new Vector3(1, 0, 0), new Vector3(), 0.1, COLOUR, 0.03, 0.02);
  private readonly canvas: HTMLCanvasElement;
  private pointer = -1;
  private grip = new Vector3(); // where it was taken hold of, in the body's frame
  private sent = 0;

  constructor(
    private readonly stage: Stage,
    private readonly push: Push,
  ) {
    this.canvas = stage.element.querySelector("canvas")!;
    this.arrow.visible = false;
    stage.scene.add(this.arrow);
    // On the way down to the canvas, so that the camera does not turn when a body is taken.
    stage.element.addEventListener("pointerdown", (event) => this.take(event), { capture: true });
    stage.element.addEventListener("pointermove", (event) => this.move(event), { capture: true });
    for (const kind of ["pointerup", "pointercancel"] as const)
      stage.element.addEventListener(kind, (event) => this.drop(event), { capture: true });
  }

  private get bodies() {
    return this.stage.figures[0].bodies.filter(({ name }) => this.push.bodies.includes(name));
  }

  private aim(event: PointerEvent): void {
    const box = this.canvas.getBoundingClientRect();
    const place = new Vector2((2 * (event.clientX - box.x)) / box.width - 1, 1 - (2 * (event.clientY - box.y)) / box.height);
    this.caster.setFromCamera(place, this.stage.camera);
  }

  private take(event: PointerEvent): void {
    if (event.button !== 0 || event.target !== this.canvas || this.pointer >= 0) return;
    this.aim(event);
    const [hit] = this.caster.intersectObjects(this.stage.figures[0].bodies, true);
    if (!hit || !this.bodies.some((body) => body === hit.object.parent)) return;
    event.stopPropagation();
    this.pointer = event.pointerId;
    this.canvas.setPointerCapture(event.pointerId);
    this.grip = this.bodies[0].worldToLocal(hit.point.clone());
    const ahead = this.stage.camera.getWorldDirection(new Vector3());
    this.plane.setFromNormalAndCoplanarPoint(ahead, hit.point);
  }

  private move(event: PointerEvent): void {
    if (event.pointerId !== this.pointer) return;
    event.stopPropagation();
    this.aim(event);
    const to = this.caster.ray.intersectPlane(this.plane, new Vector3());
    if (!to) return;
    const from = this.bodies[0].localToWorld(this.grip.clone());
    const force = to.sub(from).multiplyScalar(STIFFNESS).clampLength(0, this.push.limit);
    this.show(from, force);
    if (performance.now() - this.sent < INTERVAL) return;
    this.sent = performance.now();
    this.push.send([force.x, force.y, force.z]);
  }

  private drop(event: PointerEvent): void {
    if (event.pointerId !== this.pointer) return;
    event.stopPropagation();
    this.pointer = -1;
    this.sent = 0;
    this.arrow.visible = false;
    this.stage.refresh();
    this.push.send(null);
  }

  private show(from: Vector3, force: Vector3): void {
    const size = force.length();
    this.arrow.visible = size > 0.1;
    if (this.arrow.visible) {
      this.arrow.position.copy(from);
      this.arrow.setDirection(force.normalize());
      this.arrow.setLength(Math.max(size * METRES_PER_NEWTON, 0.04), 0.03, 0.02);
      force.multiplyScalar(size);
    }
    this.stage.refresh();
  }
}
