// A model in the scene, solid or as a ghost: one group per body, posed from qpos.
import { type BufferGeometry, type Color, Group, Mesh, MeshLambertMaterial, type MeshStandardMaterial } from "three";
import type { ModelData, ShapeData } from "../data/types.ts";
import { floorGeometry, meshGeometry, projectTexture, shapeGeometry } from "./geometry.ts";
import { Kinematics, quaternion } from "./kinematics.ts";
import { ghostMaterials, loadTextures, shapeMaterial } from "./materials.ts";

const FLOOR_DIM = 0.16; // brightness of the floor in dark colours
const FLOOR_REACH = 2.2; // radius of the floor, in model extents
const BRIGHTER = 1.5; // factor on textured floors, whose textures are dark
const GHOST_ORDER = 10; // drawn after everything solid

export interface Look {
  isGhost: boolean;
  anisotropy: number; // of textures
}

export class Figure {
  readonly root = new Group();
  readonly bodies: Group[];
  private readonly kinematics: Kinematics;
  private readonly floors: { material: MeshLambertMaterial; colour: Color }[] = [];

  private constructor(
    readonly model: ModelData,
    readonly isGhost: boolean,
  ) {
    this.kinematics = new Kinematics(model);
    this.bodies = model.bodies.map(({ name }) => {
      const body = new Group();
      body.name = name;
      this.root.add(body);
      return body;
    });
  }

  static async build(model: ModelData, { isGhost, anisotropy }: Look): Promise<Figure> {
    const figure = new Figure(model, isGhost);
    const meshes = await Promise.all(model.meshes.map(meshGeometry));
    const textures = isGhost ? [] : await loadTextures(model.textures, anisotropy);
    model.bodies.forEach((body, index) => {
      if (isGhost && body.fixed) return;
      for (const shape of body.shapes) {
        const geometry = shapeGeometry(shape, meshes);
        if (isGhost) figure.addGhost(index, shape, new Mesh(geometry));
        else figure.addSolid(index, shape, new Mesh(geometry, shapeMaterial(shape, textures)));
      }
    });
    figure.pose(model.qpos0);
    return figure;
  }

  /** Pose all bodies. */
  pose(qpos: ArrayLike<number>): void {
    this.kinematics.pose(qpos, this.bodies);
  }

  /** Adapt the floor to the colour scheme. */
  set dark(isDark: boolean) {
    for (const { material, colour } of this.floors) material.color.copy(colour).multiplyScalar(isDark ? FLOOR_DIM : 1);
  }

  private addSolid(body: number, shape: ShapeData, mesh: Mesh<BufferGeometry, MeshStandardMaterial>): void {
    const isFloor = shape.kind === "plane" && this.model.bodies[body].fixed && Math.abs(quaternion(shape.quat).w) > 0.999;
    if (isFloor) {
      this.addFloor(body, shape, mesh.material);
      return;
    }
    if (mesh.material.map) projectTexture(mesh.geometry, shape);
    mesh.castShadow = shape.rgba[3] > 0.5;
    mesh.receiveShadow = true;
    this.add(body, shape, mesh);
  }

  /** Add a matt floor that fades into the page. */
  private addFloor(body: number, shape: ShapeData, { map, color }: MeshStandardMaterial): void {
    const material = new MeshLambertMaterial({ map, color, vertexColors: true, transparent: true, depthWrite: false });
    if (map) material.color.setScalar(BRIGHTER);
    const mesh = new Mesh(floorGeometry(Math.max(FLOOR_REACH * this.model.extent, 1)), material);
    if (map) projectTexture(mesh.geometry, shape);
    mesh.receiveShadow = true;
    mesh.renderOrder = -1;
    this.floors.push({ material, colour: material.color.clone() });
    this.add(body, shape, mesh);
  }

  private addGhost(body: number, shape: ShapeData, mesh: Mesh): void {
    const [depth, tint] = ghostMaterials();
    const front = mesh.clone();
    mesh.material = depth;
    front.material = tint;
    mesh.renderOrder = GHOST_ORDER;
    front.renderOrder = GHOST_ORDER + 1;
    this.add(body, shape, mesh);
    this.add(body, shape, front);
  }

  private add(body: number, shape: ShapeData, mesh: Mesh): void {
    mesh.position.set(shape.pos[0], shape.pos[1], shape.pos[2]);
    mesh.quaternion.copy(quaternion(shape.quat));
    this.bodies[body].add(mesh);
  }
}
