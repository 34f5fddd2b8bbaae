// Forward kinematics: body frames in the world from qpos, as mj_kinematics computes them.
import { Quaternion, Vector3 } from "three";
import type { BodyData, JointData, ModelData } from "../data/types.ts";

/** A body's frame in the world. */
export interface Frame {
  position: Vector3;
  quaternion: Quaternion;
}

interface Joint extends Pick<JointData, "kind" | "address" | "zero"> {
  axis: Vector3;
  anchor: Vector3;
}

interface Body {
  parent: number;
  position: Vector3;
  quaternion: Quaternion;
  joints: Joint[];
}

/** Make a quaternion of (w, x, y, z). */
export function quaternion([w, x, y, z]: readonly number[]): Quaternion {
  return new Quaternion(x, y, z, w);
}

function prepare(body: BodyData): Body {
  const joints = body.joints.map(({ kind, address, zero, axis, pos }) => ({
    kind,
    address,
    zero,
    axis: new Vector3(...axis).normalize(),
    anchor: new Vector3(...pos),
  }));
  const position = new Vector3(...body.pos);
  return { parent: body.parent, position, quaternion: quaternion(body.quat).normalize(), joints };
}

export class Kinematics {
  private readonly bodies: Body[];
  private readonly turn = new Quaternion();
  private readonly before = new Vector3();
  private readonly after = new Vector3();

  constructor(model: ModelData) {
    this.bodies = model.bodies.map(prepare);
  }

  /** Pose all bodies; `frames` are in the model's order, the world first. */
  pose(qpos: ArrayLike<number>, frames: readonly Frame[]): void {
    for (let index = 1; index < this.bodies.length; index++) {
      const body = this.bodies[index];
      const frame = frames[index];
      const parent = frames[body.parent];
      frame.position.copy(body.position).applyQuaternion(parent.quaternion).add(parent.position);
      frame.quaternion.multiplyQuaternions(parent.quaternion, body.quaternion);
      for (const joint of body.joints) this.move(frame, joint, qpos);
      frame.quaternion.normalize();
    }
  }

  private move(frame: Frame, joint: Joint, qpos: ArrayLike<number>): void {
    const at = joint.address;
    switch (joint.kind) {
      case "free":
        frame.position.set(qpos[at], qpos[at + 1], qpos[at + 2]);
        frame.quaternion.set(qpos[at + 4], qpos[at + 5], qpos[at + 6], qpos[at + 3]).normalize();
        return;
      case "slide":
        this.before.copy(joint.axis).applyQuaternion(frame.quaternion);
        frame.position.addScaledVector(this.before, qpos[at] - joint.zero);
        return;
      case "ball":
        this.turn.set(qpos[at + 1], qpos[at + 2], qpos[at + 3], qpos[at]).normalize();
        return this.rotate(frame, joint);
      case "hinge":
        this.turn.setFromAxisAngle(joint.axis, qpos[at] - joint.zero);
        return this.rotate(frame, joint);
    }
  }

  /** Rotate a frame about a joint's anchor, which stays in place. */
  private rotate(frame: Frame, joint: Joint): void {
    this.before.copy(joint.anchor).applyQuaternion(frame.quaternion);
    frame.quaternion.multiply(this.turn);
    this.after.copy(joint.anchor).applyQuaternion(frame.quaternion);
    frame.position.add(this.before).sub(this.after);
  }
}
