// Shapes of the model as three.js geometry in their own frames; MuJoCo's sizes are half sizes.
import {
  BufferAttribute,
  BufferGeometry,
  CapsuleGeometry,
  CylinderGeometry,
  PlaneGeometry,
  RingGeometry,
  SphereGeometry,
} from "three";
import { RoundedBoxGeometry } from "three/examples/jsm/geometries/RoundedBoxGeometry.js";
import { toCreasedNormals } from "three/examples/jsm/utils/BufferGeometryUtils.js";
import { inflate } from "../data/codec.ts";
import type { MeshData, ShapeData } from "../data/types.ts";

const ENDLESS = 40; // [m] side of a plane without a size
const CREASE = 0.7; // [rad] between faces; larger angles are sharp edges
const ROUNDING = 0.0015; // [m] of a box's edges, so that they catch the light
const QUARTER = Math.PI / 2;

/** Return a shape's geometry; meshes are those of its model. */
export function shapeGeometry(shape: ShapeData, meshes: readonly BufferGeometry[]): BufferGeometry {
  const [a, b, c] = shape.size;
  switch (shape.kind) {
    case "plane":
      return new PlaneGeometry(a ? 2 * a : ENDLESS, b ? 2 * b : ENDLESS);
    case "sphere":
      return new SphereGeometry(a, 32, 20);
    case "ellipsoid":
      return new SphereGeometry(1, 36, 24).scale(a, b, c);
    case "cylinder":
      return new CylinderGeometry(a, a, 2 * b, 40).rotateX(QUARTER);
    case "capsule":
      return new CapsuleGeometry(a, 2 * b, 10, 28).rotateX(QUARTER);
    case "box":
      return new RoundedBoxGeometry(2 * a, 2 * b, 2 * c, 2, Math.min(ROUNDING, a / 4, b / 4, c / 4));
    case "mesh":
      return meshes[shape.mesh ?? 0];
  }
}

/** Decode a mesh, with normals that keep its sharp edges. */
export async function meshGeometry(mesh: MeshData): Promise<BufferGeometry> {
  const whole = new Uint16Array((await inflate(mesh.vertices)).buffer);
  const steps = new Int32Array((await inflate(mesh.faces)).buffer);
  const points = Float32Array.from(whole, (value, index) => mesh.low[index % 3] + (mesh.span[index % 3] * value) / 65535);
  let vertex = 0;
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(points, 3));
  geometry.setIndex(Array.from(steps, (step) => (vertex += step)));
  const flat = geometry.toNonIndexed();
  if (mesh.texture) {
    const places = new Float32Array((await inflate(mesh.texture)).buffer);
    flat.setAttribute("uv", new BufferAttribute(places, 2));
  }
  return toCreasedNormals(flat, CREASE);
}

/** Map a texture onto a shape as MuJoCo does, along the shape's x and y axes. */
export function projectTexture(geometry: BufferGeometry, shape: ShapeData): void {
  if (shape.kind === "mesh" && geometry.hasAttribute("uv")) return;
  const [repeatX, repeatY] = shape.repeat ?? [1, 1];
  const [width, height] = shape.uniform ? [1, 1] : [2 * shape.size[0] || 1, 2 * (shape.size[1] || shape.size[0]) || 1];
  const place = geometry.getAttribute("position");
  const uv = new Float32Array(2 * place.count);
  for (let index = 0; index < place.count; index++) {
    uv[2 * index] = (place.getX(index) / width + 0.5) * repeatX;
    uv[2 * index + 1] = (place.getY(index) / height + 0.5) * repeatY;
  }
  geometry.setAttribute("uv", new BufferAttribute(uv, 2));
}

/** Return a disc whose alpha falls towards its rim, so that the floor fades into the page. */
export function floorGeometry(radius: number): BufferGeometry {
  const geometry = new RingGeometry(0, radius, 96, 24);
  const place = geometry.getAttribute("position");
  const colour = new Float32Array(4 * place.count).fill(1);
  for (let index = 0; index < place.count; index++) {
    const share = Math.hypot(place.getX(index), place.getY(index)) / radius;
    const fade = Math.min(Math.max((1 - share) / 0.75, 0), 1);
    colour[4 * index + 3] = fade * fade * (3 - 2 * fade);
  }
  geometry.setAttribute("color", new BufferAttribute(colour, 4));
  return geometry;
}
