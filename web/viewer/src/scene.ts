// The scene as study/report/viewer/scene.py packs it, unpacked into typed arrays.

export interface Packed {
  type: "float32" | "int16" | "uint16" | "uint32";
  shape: number[];
  scale: number;
  data: string;
}

export interface Bone {
  name: string;
  kind: "vertebra" | "rib" | "other";
  vertices: number;
  faces: number;
}

export type Vec = [number, number, number];
export type Corner = [number, number];

/** Outlines of vertebrae, mm at a view's patient plane, and pedicles by name, as "T8 left". */
export interface Outlined {
  vertebrae: string[];
  boxes: Corner[][];
  pedicles?: Record<string, Corner>;
}

/** What a frame shows beside its frontal corners: pedicles, outlines by further view, markers on the skin by name. */
export interface Beside {
  pedicles?: Record<string, Corner>;
  outlines?: Record<string, Outlined>;
  markers?: Record<string, Vec>;
}

/** The source, and the patient plane: a point of it lies at origin + u columns + v rows. */
export interface Plane {
  source: Vec;
  origin: Vec;
  columns: Vec;
  rows: Vec;
}

export interface Frame extends Beside {
  frame: number;
  force: number;
  role: string;
  vertebrae: string[];
  measured: Corner[][];
  rmse: Record<string, number>;
}

export interface Step extends Beside, Outlined {
  force: number;
  frame: number | null;
  state: number;
  reactions: Vec[];
}

export interface Support {
  name: string;
  kind: "held" | "shoulder" | "wall" | "spring";
  bone: number;
  offset: Vec;
  direction: Vec | null;
}

export interface Push {
  id: string;
  side: "left" | "right";
  level: number;
  view: Plane;
  further?: Record<string, Plane>;
  load: { bone: number[]; offset: Vec[]; force: Vec[] };
  supports: Support[];
  frames: Frame[];
  models: Record<string, Step[]>;
}

interface Stored {
  version: number;
  title: string;
  bones: Bone[];
  vertices: Packed;
  faces: Packed;
  skin: Packed;
  joints: { names: string[]; bone: number[]; offset: Packed };
  states: { bones: Packed; skin: Packed };
  pushes: Push[];
}

export interface Scene {
  bones: Bone[];
  /** Vertices of all bones in their own frames, mm; one bone after the other. */
  vertices: Float32Array;
  faces: Uint32Array;
  /** Corners a skin face has: 3 or 6. */
  skinWidth: number;
  skinFaces: Uint32Array;
  joints: { names: string[]; bone: number[]; offset: Float32Array };
  /** x, y, z, then quaternion x, y, z, w of each bone; one array a state, the rest pose first. */
  poses: Float32Array[];
  skins: Float32Array[];
  pushes: Push[];
}

const VERSION = 1;

export function readScene(text: string): Scene {
  const stored = JSON.parse(text) as Stored;
  if (stored.version !== VERSION) throw new Error(`scene of version ${stored.version}, wanted ${VERSION}`);
  const count = stored.states.bones.shape[0] ?? 0;
  return {
    bones: stored.bones,
    vertices: floats(stored.vertices),
    faces: wholes(stored.faces),
    skinWidth: stored.skin.shape[1] ?? 3,
    skinFaces: wholes(stored.skin),
    joints: { ...stored.joints, offset: floats(stored.joints.offset) },
    poses: split(floats(stored.states.bones), count),
    skins: split(floats(stored.states.skin), count),
    pushes: stored.pushes,
  };
}

function bytes(data: string): ArrayBuffer {
  const text = atob(data);
  const found = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) found[i] = text.charCodeAt(i);
  return found.buffer;
}

function numbers(packed: Packed): Float32Array | Int16Array | Uint16Array | Uint32Array {
  const buffer = bytes(packed.data);
  switch (packed.type) {
    case "float32":
      return new Float32Array(buffer);
    case "int16":
      return new Int16Array(buffer);
    case "uint16":
      return new Uint16Array(buffer);
    case "uint32":
      return new Uint32Array(buffer);
  }
}

function floats(packed: Packed): Float32Array {
  const found = Float32Array.from(numbers(packed));
  if (packed.scale !== 1) for (let i = 0; i < found.length; i++) found[i]! *= packed.scale;
  return found;
}

function wholes(packed: Packed): Uint32Array {
  return Uint32Array.from(numbers(packed));
}

function split(all: Float32Array, parts: number): Float32Array[] {
  const size = parts ? all.length / parts : 0;
  return Array.from({ length: parts }, (_, i) => all.subarray(i * size, (i + 1) * size));
}
