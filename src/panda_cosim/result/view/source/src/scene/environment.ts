// A studio for reflections: bright ceiling, two soft boxes, grey floor.
import { BackSide, BoxGeometry, Mesh, MeshBasicMaterial, Scene } from "three";

function panel(size: [number, number, number], place: [number, number, number], brightness: number): Mesh {
  const material = new MeshBasicMaterial();
  material.color.setScalar(brightness);
  const mesh = new Mesh(new BoxGeometry(...size), material);
  mesh.position.set(...place);
  return mesh;
}

/** Return the room, z up. */
export function environment(): Scene {
  const scene = new Scene();
  const walls = new MeshBasicMaterial({ side: BackSide });
  walls.color.setScalar(0.55);
  scene.add(new Mesh(new BoxGeometry(10, 10, 10), walls));
  scene.add(panel([6, 6, 0.1], [0, 0, 4.9], 3.2));
  scene.add(panel([0.1, 4, 4], [4.9, -1, 1], 2.4));
  scene.add(panel([4, 0.1, 3], [-1, -4.9, 1.5], 1.6));
  scene.add(panel([10, 10, 0.1], [0, 0, -4.9], 0.32));
  return scene;
}
