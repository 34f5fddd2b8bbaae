// Data of models and runs in a page, as src/panda_cosim/result/view/model.py and run.py write it.

/** Encoded columns of numbers; see codec.ts. */
export interface Block {
  rows: number;
  steps: number[];
  offsets: number[];
  gaps: Record<string, [number, number][]>;
  data: string;
}

/** Instants [s]: even steps, or all of them. */
export type TimeData = { start: number; step: number; rows: number } | { rows: number; block: Block };

export interface ShapeData {
  kind: "plane" | "sphere" | "capsule" | "ellipsoid" | "cylinder" | "box" | "mesh";
  size: number[];
  pos: number[];
  quat: number[]; // w, x, y, z
  rgba: number[];
  mesh?: number;
  texture?: number;
  repeat?: number[];
  uniform?: boolean;
  specular?: number;
  shininess?: number;
  emission?: number;
}

export interface JointData {
  name: string;
  kind: "free" | "ball" | "slide" | "hinge";
  address: number; // in qpos
  axis: number[];
  pos: number[];
  zero: number; // joint position at which the body has the model's pose
  range: number[];
}

export interface BodyData {
  name: string;
  parent: number;
  fixed: boolean;
  pos: number[];
  quat: number[]; // w, x, y, z
  mass: number; // of the model [kg]; a run may have had another
  com: number[]; // centre of mass in its frame [m]
  joints: JointData[];
  shapes: ShapeData[];
}

export interface MeshData {
  low: number[];
  span: number[];
  vertices: string;
  faces: string;
  texture?: string;
}

/** Pixels are deflated RGBA, from the lower left. */
export interface TextureData {
  width: number;
  height: number;
  pixels: string;
}

export interface CameraData {
  name: string;
  body: number;
  pos: number[];
  quat: number[]; // w, x, y, z
  fovy: number; // [deg]
}

export interface ModelData {
  nq: number;
  qpos0: number[];
  gravity: number[]; // [m/s^2]
  bodies: BodyData[];
  meshes: MeshData[];
  textures: TextureData[];
  cameras: CameraData[];
  center: number[];
  extent: number;
}

export interface SignalData extends Block {
  name: string;
  columns: string[];
  units: string[];
  words: string;
}

export interface Criterion {
  name: string;
  value: number | null;
  bound: number | null;
  unit: string;
  ok: boolean;
  least: boolean;
  words: string;
}

export interface Limit {
  name: string;
  words: string;
  shares: (number | null)[];
}

export interface Mark {
  time: number;
  label: string;
  place?: [number, number, number]; // [m]; if missing, the commanded position at that time
}

export interface CurveChoice {
  title: string;
  columns: string[];
}

export type Role = "qpos" | "actual" | "actual_turn" | "commanded" | "commanded_turn";

export interface RunData {
  name: string;
  title: string;
  purpose: string;
  facts: string[];
  model: string; // "": it has none, and curves alone are shown
  verdict: { state: "good" | "bad" | "plain"; words: string };
  criteria: Criterion[];
  limits: Limit[];
  notes: string[];
  time: TimeData;
  signals: SignalData[];
  poses: (Block & { time: TimeData; columns: string[] }) | null;
  roles: Partial<Record<Role, string[]>>;
  masses: number[] | null;
  moments: Mark[];
  waypoints: Mark[];
  bounds: Record<string, [number, number]>;
  curves: CurveChoice[];
}
