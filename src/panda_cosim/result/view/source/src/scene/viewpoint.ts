// The viewpoint: the model's cameras, free orbit, following the hand.
import { type PerspectiveCamera, Quaternion, Vector3 } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import type { CameraData, ModelData } from "../data/types.ts";
import type { Frame } from "./kinematics.ts";
import { quaternion } from "./kinematics.ts";

const WIDE = 4 / 3; // narrower pictures get a wider field of view
const NEAREST = 0.15; // [m] smallest distance from a camera to its orbit target
const MOVE_TIME = 280; // [ms] from one camera to the next

interface Pose {
  eye: Vector3;
  target: Vector3;
  fovy: number;
}

export class Viewpoint {
  readonly names: string[];
  private readonly controls: OrbitControls;
  private chosen = "";
  private riding: CameraData | null = null;
  private followed: (() => number[] | null) | null = null;
  private before: Vector3 | null = null;
  private fovy = 45;
  private move: { from: Pose; to: Pose; start: number } | null = null;

  constructor(
    private readonly camera: PerspectiveCamera,
    canvas: HTMLElement,
    private readonly model: ModelData,
    private readonly frames: readonly Frame[],
    private readonly changed: () => void,
  ) {
    this.controls = new OrbitControls(camera, canvas);
    this.controls.enableDamping = true;
    this.controls.dampingFactor = 0.2;
    this.controls.maxPolarAngle = Math.PI * 0.55;
    this.controls.minDistance = 0.1;
    this.controls.maxDistance = 12 * model.extent;
    this.controls.addEventListener("start", () => this.release());
    this.controls.addEventListener("change", () => this.changed());
    const own = model.cameras.map(({ name }) => name);
    this.names = [...new Set([...(own.length ? own : ["overview"]), "top"])];
  }

  /** Name of the active camera, or six numbers (eye, target) for a free view. */
  get name(): string {
    if (this.chosen) return this.chosen;
    const numbers = [...this.camera.position.toArray(), ...this.controls.target.toArray()];
    return numbers.map((value) => value.toFixed(3)).join(",");
  }

  get following(): boolean {
    return this.followed !== null;
  }

  /** Use a camera by name, or six numbers (eye, target); returns whether there is such a view. */
  look(name: string, smoothly = true): boolean {
    const numbers = name.split(",").map(Number);
    if (numbers.length === 6 && numbers.every(Number.isFinite)) {
      this.place({ eye: new Vector3(...numbers.slice(0, 3)), target: new Vector3(...numbers.slice(3)), fovy: this.fovy }, false);
      this.chosen = "";
      return true;
    }
    if (!this.names.includes(name)) return false;
    const data = this.model.cameras.find((camera) => camera.name === name);
    this.riding = data && data.body !== 0 ? data : null;
    this.controls.enabled = true;
    if (!this.riding) this.place(data ? this.poseOf(data) : this.from(name), smoothly);
    this.chosen = name;
    this.changed();
    return true;
  }

  /** Follow a moving point; null stops following. */
  follow(place: (() => number[] | null) | null): void {
    const now = place?.() ?? null;
    this.followed = place;
    this.before = now && new Vector3(...now);
    this.centre(now);
    this.changed();
  }

  /** Rotate about the target by angles [rad], and scale the distance by a factor. */
  orbit(around: number, up: number, nearer = 1): void {
    this.release();
    const offset = this.camera.position.clone().sub(this.controls.target);
    const distance = Math.min(Math.max(offset.length() * nearer, this.controls.minDistance), this.controls.maxDistance);
    const azimuth = Math.atan2(offset.y, offset.x) + around;
    const level = Math.asin(Math.min(Math.max(offset.z / offset.length(), -1), 1)) + up;
    const height = Math.min(Math.max(level, -0.15), 1.55);
    offset.set(Math.cos(height) * Math.cos(azimuth), Math.cos(height) * Math.sin(azimuth), Math.sin(height));
    this.camera.position.copy(this.controls.target).addScaledVector(offset, distance);
    this.controls.update();
    this.changed();
  }

  /** Update the camera before a frame; returns whether it is still moving. */
  update(now: number): boolean {
    if (this.move) this.advance(now);
    this.keepUp();
    if (this.riding) this.ride(this.riding);
    else this.controls.update();
    return this.move !== null;
  }

  /** Fit the field of view to the picture's aspect ratio. */
  resize(aspect: number): void {
    this.camera.aspect = aspect;
    const half = Math.tan((this.fovy * Math.PI) / 360) * Math.max(1, WIDE / aspect);
    this.camera.fov = (Math.atan(half) * 360) / Math.PI;
    this.camera.updateProjectionMatrix();
  }

  dispose(): void {
    this.controls.dispose();
  }

  /** Change to a free view from the camera's present pose. */
  private release(): void {
    this.move = null;
    if (this.riding) {
      const ahead = new Vector3(0, 0, -1).applyQuaternion(this.camera.quaternion);
      this.controls.target.copy(this.camera.position).addScaledVector(ahead, 0.5);
      this.riding = null;
    }
    this.chosen = "";
  }

  private place(pose: Pose, smoothly: boolean): void {
    const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const from = { eye: this.camera.position.clone(), target: this.controls.target.clone(), fovy: this.fovy };
    this.riding = null;
    this.move = { from, to: pose, start: smoothly && !calm ? performance.now() : -Infinity };
    this.advance(performance.now());
    this.before = null;
  }

  private advance(now: number): void {
    const { from, to, start } = this.move!;
    const share = Math.min((now - start) / MOVE_TIME, 1);
    const eased = share * share * (3 - 2 * share);
    this.camera.position.lerpVectors(from.eye, to.eye, eased);
    this.controls.target.lerpVectors(from.target, to.target, eased);
    this.fovy = from.fovy + eased * (to.fovy - from.fovy);
    this.resize(this.camera.aspect);
    this.controls.update();
    if (share >= 1) this.move = null;
  }

  private keepUp(): void {
    const place = this.followed?.();
    if (!place || this.riding) return;
    const now = new Vector3(...place);
    if (this.before) {
      const way = now.clone().sub(this.before);
      this.camera.position.add(way);
      this.controls.target.add(way);
    }
    this.before = now;
  }

  private centre(place: number[] | null): void {
    if (!place) return;
    this.release();
    const way = new Vector3(...place).sub(this.controls.target);
    this.controls.target.add(way);
    this.camera.position.add(way);
  }

  private poseOf(data: CameraData): Pose {
    const [eye, turn] = this.inWorld(data);
    const ahead = new Vector3(0, 0, -1).applyQuaternion(turn);
    const depth = new Vector3(...this.model.center).sub(eye).dot(ahead);
    const target = eye.clone().addScaledVector(ahead, Math.max(depth, NEAREST));
    return { eye, target, fovy: data.fovy };
  }

  private inWorld(data: CameraData): [Vector3, Quaternion] {
    const { position, quaternion: turn } = this.frames[data.body];
    const eye = new Vector3(...data.pos).applyQuaternion(turn).add(position);
    return [eye, turn.clone().multiply(quaternion(data.quat))];
  }

  private ride(data: CameraData): void {
    const [eye, turn] = this.inWorld(data);
    this.camera.position.copy(eye);
    this.camera.quaternion.copy(turn);
    if (this.fovy !== data.fovy) {
      this.fovy = data.fovy;
      this.resize(this.camera.aspect);
    }
  }

  private from(name: string): Pose {
    const target = new Vector3(...this.model.center);
    const way = name === "top" ? new Vector3(-0.001, 0, 2) : new Vector3(0.7, -1.6, 1); // in extents
    const eye = target.clone().addScaledVector(way, this.model.extent);
    return { eye, target, fovy: 40 };
  }
}
