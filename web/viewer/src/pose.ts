// Where everything is at a force: a solved state, or between two of them.
import { Quaternion, Vector3 } from "three";
import type { Corner, Outlined, Scene, Step, Vec } from "./scene";

export interface Pose {
  places: Vector3[];
  turns: Quaternion[];
  skin: Float32Array;
}

/** The steps around a force and the share of the later one; `share` is 0 on a step. */
export interface Bracket {
  before: Step;
  after: Step;
  share: number;
}

export function restPose(scene: Scene): Pose {
  return between(scene, 0, 0, 0);
}

/** `frame` decides between steps of the same force. */
export function bracket(steps: Step[], force: number, frame: number | null = null): Bracket {
  const exact = steps.filter((step) => Math.abs(step.force - force) < 1e-9);
  const chosen = exact.find((step) => frame !== null && step.frame === frame) ?? exact[0];
  if (chosen) return { before: chosen, after: chosen, share: 0 };
  const first = steps[0]!;
  const last = steps[steps.length - 1]!;
  if (force >= last.force) return { before: last, after: last, share: 0 };
  const next = Math.max(
    steps.findIndex((step) => step.force > force),
    1,
  );
  const before = steps[next - 1] ?? first;
  const after = steps[next] ?? last;
  return { before, after, share: (force - before.force) / (after.force - before.force) };
}

/** Bones move along straight lines and turn by slerp, the skin moves along straight lines. */
export function poseAt(scene: Scene, where: Bracket): Pose {
  return between(scene, where.before.state, where.after.state, where.share);
}

function between(scene: Scene, first: number, second: number, share: number): Pose {
  const a = scene.poses[first]!;
  const b = scene.poses[second]!;
  const places: Vector3[] = [];
  const turns: Quaternion[] = [];
  for (let i = 0; i < scene.bones.length; i++) {
    places.push(new Vector3().fromArray(a, 7 * i).lerp(new Vector3().fromArray(b, 7 * i), share));
    turns.push(new Quaternion().fromArray(a, 7 * i + 3).slerp(new Quaternion().fromArray(b, 7 * i + 3), share));
  }
  const from = scene.skins[first]!;
  const to = scene.skins[second]!;
  return { places, turns, skin: from.map((value, i) => value + share * (to[i]! - value)) };
}

export function onBone(pose: Pose, bone: number, offset: Vec | Vector3): Vector3 {
  const point = offset instanceof Vector3 ? offset.clone() : new Vector3(...offset);
  return point.applyQuaternion(pose.turns[bone]!).add(pose.places[bone]!);
}

/** What a radiograph shows, mm at its view's patient plane: outlines of vertebrae, and pedicles. */
export interface InPlane {
  boxes: Corner[][];
  pedicles: Corner[];
}

/** Simulated outlines and pedicles that both steps have, moved in proportion. */
export function planeAt(where: Bracket): InPlane {
  return planeBetween(where.before, where.after, where.share);
}

function planeBetween(before: Outlined, after: Outlined, share: number): InPlane {
  const between = ([u, v]: Corner, [x, y]: Corner): Corner => [u + share * (x - u), v + share * (y - v)];
  const boxes = before.vertebrae.flatMap((name, i): Corner[][] => {
    const other = after.boxes[after.vertebrae.indexOf(name)];
    return other ? [before.boxes[i]!.map((corner, k) => between(corner, other[k]!))] : [];
  });
  const pedicles = Object.entries(before.pedicles ?? {}).flatMap(([name, point]): Corner[] => {
    const other = after.pedicles?.[name];
    return other ? [between(point, other)] : [];
  });
  return { boxes, pedicles };
}

/** The same by further view, of those that both steps have. */
export function furtherAt(where: Bracket): Record<string, InPlane> {
  const found: Record<string, InPlane> = {};
  for (const [view, before] of Object.entries(where.before.outlines ?? {})) {
    const after = where.after.outlines?.[view];
    if (after) found[view] = planeBetween(before, after, where.share);
  }
  return found;
}

/** Simulated markers that both steps have. */
export function markersAt(where: Bracket): Vector3[] {
  const after = where.after.markers ?? {};
  return Object.entries(where.before.markers ?? {}).flatMap(([name, place]) => {
    const other = after[name];
    return other ? [new Vector3(...place).lerp(new Vector3(...other), where.share)] : [];
  });
}

/** Forces of the supports on the torso, N. */
export function reactionsAt(where: Bracket): Vector3[] {
  return where.before.reactions.map((force, i) =>
    new Vector3(...force).lerp(new Vector3(...where.after.reactions[i]!), where.share),
  );
}
