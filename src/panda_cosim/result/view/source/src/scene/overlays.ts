// Layers over the model: paths, frames, forces, waypoints.
import { Color, ConeGeometry, CylinderGeometry, Group, Mesh, MeshBasicMaterial, type Object3D, SphereGeometry, Vector3 } from "three";
import { Line2 } from "three/examples/jsm/lines/Line2.js";
import { LineGeometry } from "three/examples/jsm/lines/LineGeometry.js";
import { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
import { rowAt } from "../data/lookup.ts";
import type { Path, RunSource } from "../data/source.ts";
import { quaternion } from "./kinematics.ts";
import { type Load, Loads } from "./loads.ts";

const METRES_PER_NEWTON = 0.05;
const LONGEST = 0.3; // [m] length of an arrow
const LEAST = 0.05; // [N] smaller forces are not drawn
const WINDOW = 8000; // points of a path that are drawn
const APART = 0.002; // [m] distance of a path's drawn points; nearer ones look the same and cost time
const HOP = 2000; // points by which the drawn section moves on
const HEAD = 0.025; // [m] of an arrow
const UP = new Vector3(0, 1, 0);
const AXES = [0xe5484d, 0x30a46c, 0x3e63dd]; // x, y, z

export const COLOURS = { actual: 0x2f7cf6, commanded: 0xf2933a, ghost: 0x2f8cff, force: 0xe5337e };

/** A layer that the user can hide. */
export interface Layer {
  name: string;
  key: string;
  object: Object3D;
  update(time: number): void;
}

function line(points: ArrayLike<number>, color: number, width: number, extra: object = {}): Line2 {
  const geometry = new LineGeometry();
  geometry.setPositions(Float32Array.from(points));
  // Lines write no depth, so that of two coincident lines the later one shows.
  const material = new LineMaterial({ color, linewidth: width, transparent: true, depthWrite: false, ...extra });
  const made = new Line2(geometry, material);
  made.frustumCulled = false;
  return made;
}

/** A path as a line; of a long path, only the section around the current time. */
class Trail {
  private first = 0; // row of the path at which the line begins

  constructor(
    private readonly path: Path,
    readonly lines: Line2[],
  ) {}

  /** Move the section along; returns how many of its points lie before an instant. */
  update(time: number): number {
    const row = rowAt(this.path.time, time);
    const first = Math.max(Math.floor(row / HOP) * HOP - WINDOW / 2, 0);
    if (this.path.time.length > WINDOW && first !== this.first) this.redraw(first);
    return row - this.first;
  }

  private redraw(first: number): void {
    this.first = first;
    const points = this.path.points.subarray(3 * first, 3 * (first + WINDOW));
    for (const each of this.lines) {
      each.geometry.dispose();
      each.geometry = new LineGeometry().setPositions(points);
    }
  }
}

/** Thin a path: a run has a thousand points per second, most of them less than a pixel apart. */
function sparse({ time, points }: Path): Path {
  const kept = [0];
  const apart = (one: number, other: number) =>
    Math.hypot(...[0, 1, 2].map((axis) => points[3 * one + axis] - points[3 * other + axis]));
  for (let row = 1; row < time.length; row++) {
    if (apart(row, kept[kept.length - 1]) >= APART || row === time.length - 1) kept.push(row);
  }
  return {
    time: Float64Array.from(kept, (row) => time[row]),
    points: Float32Array.from(kept.flatMap((row) => [...points.subarray(3 * row, 3 * row + 3)])),
  };
}

function trail(whole: Path, ...styles: [colour: number, width: number, extra?: object][]): Trail {
  const path = sparse(whole);
  const points = path.points.subarray(0, 3 * WINDOW);
  return new Trail(path, styles.map(([colour, width, extra]) => line(points, colour, width, extra)));
}

/** The hand's actual path: strong up to now, faint afterwards. */
export function actualPath(run: RunSource, colour: number): Layer | null {
  const path = run.path("actual");
  if (!path || path.time.length < 2) return null;
  const drawn = trail(path, [colour, 1.6, { opacity: 0.45 }], [colour, 3]);
  const [whole, done] = drawn.lines;
  whole.renderOrder = 2;
  done.renderOrder = 3;
  const update = (time: number) => {
    const over = drawn.update(time);
    done.geometry.instanceCount = over;
  };
  return { name: "path of the hand", key: "path", object: new Group().add(whole, done), update };
}

/** The commanded path: a broad band, since the actual one is close to it. */
export function commandedPath(run: RunSource): Layer | null {
  const path = run.path("commanded");
  if (!path || path.time.length < 2) return null;
  const drawn = trail(path, [COLOURS.commanded, 8, { opacity: 0.5 }]);
  const [band] = drawn.lines;
  band.renderOrder = 1;
  return { name: "commanded path", key: "command", object: band, update: (time) => void drawn.update(time) };
}

function axes(length: number, width: number, opacity: number): Group {
  const lines = AXES.map((colour, axis) => {
    const end = [0, 0, 0];
    end[axis] = length;
    return line([0, 0, 0, ...end], colour, width, { opacity, depthTest: false });
  });
  const group = new Group().add(...lines);
  for (const each of lines) each.renderOrder = 30;
  return group;
}

/** Frames of the hand (thick) and of its command (thin). */
export function frames(run: RunSource): Layer | null {
  if (!run.path("actual")) return null;
  const hand = axes(0.1, 4, 1);
  const command = axes(0.14, 1.6, 0.8);
  const place = (object: Object3D, at: number[] | null, turn: number[] | null) => {
    object.visible = at !== null;
    if (at) object.position.set(at[0], at[1], at[2]);
    if (turn) object.quaternion.copy(quaternion(turn)).normalize();
  };
  const update = (time: number) => {
    place(hand, run.at("actual", time), run.at("actual_turn", time));
    place(command, run.at("commanded", time), run.at("commanded_turn", time));
  };
  return { name: "frames", key: "frames", object: new Group().add(hand, command), update };
}

function arrow(material: MeshBasicMaterial): Group {
  const shaft = new Mesh(new CylinderGeometry(0.003, 0.003, 1, 12).translate(0, 0.5, 0), material);
  const head = new Mesh(new ConeGeometry(0.009, HEAD, 16).translate(0, HEAD / 2, 0), material);
  const group = new Group().add(shaft, head);
  for (const part of [shaft, head]) part.renderOrder = 25;
  return group;
}

/** Orient and scale an arrow; a short one also has a small head. */
function point(group: Object3D, { place, force }: Load): void {
  const strength = force.length();
  const length = Math.min(strength * METRES_PER_NEWTON, LONGEST);
  const size = Math.min(length / (2 * HEAD), 1);
  const [shaft, head] = group.children;
  group.position.copy(place);
  group.quaternion.setFromUnitVectors(UP, force.divideScalar(strength || 1));
  shaft.scale.set(size, Math.max(length - HEAD * size, 1e-4), size);
  head.scale.setScalar(size);
  head.position.y = length - HEAD * size;
}

/** Forces on free bodies besides their weights, as arrows. */
export function forces(run: RunSource): Layer | null {
  const loads = new Loads(run);
  if (!loads.any) return null;
  const group = new Group();
  const material = new MeshBasicMaterial({ color: new Color(COLOURS.force), depthTest: false, transparent: true });
  const update = (time: number) => {
    group.children.forEach((child) => (child.visible = false));
    loads.at(time).forEach((load, index) => {
      if (group.children.length <= index) group.add(arrow(material));
      const child = group.children[index];
      child.visible = load.force.length() > LEAST;
      point(child, load);
    });
  };
  const scale = `${METRES_PER_NEWTON * 1e3} mm per N, up to ${LONGEST / METRES_PER_NEWTON} N`;
  return { name: `forces on bodies, less weight (${scale})`, key: "forces", object: group, update };
}

/** Waypoints: where the rows of the scenario's table command the hand to be. */
export function waypoints(run: RunSource): Layer | null {
  const places = run.about.waypoints.map(({ time, place }) => place ?? run.at("commanded", time)).filter((place) => place !== null);
  if (!places.length) return null;
  const material = new MeshBasicMaterial({ color: COLOURS.commanded });
  const beads = places.map(([x, y, z]) => {
    const bead = new Mesh(new SphereGeometry(0.007, 16, 12), material);
    bead.position.set(x, y, z);
    return bead;
  });
  return { name: "waypoints", key: "waypoints", object: new Group().add(...beads), update: () => undefined };
}
