// Grabs something in the picture with the mouse or a finger, before the camera controls see the event.
import { Plane, Raycaster, Vector2, Vector3 } from "three";
import type { Stage } from "../scene/stage.ts";

export abstract class Hold {
  /** Whether something can be grabbed now. */
  enabled = false;
  protected readonly caster = new Raycaster();
  private readonly canvas: HTMLCanvasElement;
  private readonly plane = new Plane();
  private pointer = -1;

  constructor(protected readonly stage: Stage) {
    this.canvas = stage.element.querySelector("canvas")!;
    const listen = (kind: string, act: (event: PointerEvent) => void) =>
      stage.element.addEventListener(kind, (event) => act(event as PointerEvent), { capture: true });
    listen("pointerdown", (event) => this.press(event));
    listen("pointermove", (event) => this.pull(event));
    listen("pointerup", (event) => this.leave(event, true));
    listen("pointercancel", (event) => this.leave(event, false));
  }

  /** Return the point under the pointer at which something is grabbed, or null. */
  protected abstract take(event: PointerEvent): Vector3 | null;
  /** Follow the pointer in the plane through the grabbed point, parallel to the picture. */
  protected abstract moveTo(place: Vector3): void;
  /** Release; `done` is false if the browser cancelled the gesture. */
  protected abstract drop(done: boolean): void;

  protected get held(): boolean {
    return this.pointer >= 0;
  }

  /** Position of a point on the screen, in pixels from the canvas's corner. */
  protected seen(place: Vector3): Vector2 {
    const { width, height } = this.canvas.getBoundingClientRect();
    const spot = place.clone().project(this.stage.camera);
    return new Vector2(((spot.x + 1) / 2) * width, ((1 - spot.y) / 2) * height);
  }

  protected at(event: PointerEvent): Vector2 {
    const { x, y } = this.canvas.getBoundingClientRect();
    return new Vector2(event.clientX - x, event.clientY - y);
  }

  private aim(event: PointerEvent): void {
    const { width, height } = this.canvas.getBoundingClientRect();
    const { x, y } = this.at(event);
    this.caster.setFromCamera(new Vector2((2 * x) / width - 1, 1 - (2 * y) / height), this.stage.camera);
  }

  private press(event: PointerEvent): void {
    if (!this.enabled || event.button !== 0 || this.held || !event.isPrimary) return;
    this.aim(event);
    const place = this.take(event);
    if (!place) return;
    event.stopImmediatePropagation();
    event.preventDefault();
    this.pointer = event.pointerId;
    this.canvas.setPointerCapture(event.pointerId);
    this.plane.setFromNormalAndCoplanarPoint(this.stage.camera.getWorldDirection(new Vector3()), place);
  }

  private pull(event: PointerEvent): void {
    if (event.pointerId !== this.pointer) return;
    event.stopImmediatePropagation();
    this.aim(event);
    const place = this.caster.ray.intersectPlane(this.plane, new Vector3());
    if (place) this.moveTo(place);
  }

  private leave(event: PointerEvent, done: boolean): void {
    if (event.pointerId !== this.pointer) return;
    event.stopImmediatePropagation();
    this.pointer = -1;
    this.drop(done);
    this.stage.refresh();
  }
}
