// What acts on the torso and what was seen of it: arrows, supports, outlines of vertebrae.
import {
  BoxGeometry,
  type Color,
  ConeGeometry,
  CylinderGeometry,
  Group,
  Mesh,
  MeshBasicMaterial,
  MeshLambertMaterial,
  Quaternion,
  TorusGeometry,
  Vector3,
} from "three";
import { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
import { LineSegments2 } from "three/examples/jsm/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/examples/jsm/lines/LineSegmentsGeometry.js";
import { type InPlane, onBone, type Pose } from "./pose";
import type { Corner, Plane, Push, Support } from "./scene";
import type { Seen } from "./stage";

const UP = new Vector3(0, 1, 0);
const LEAST_N = 0.5;
// mm from the point on the bone to what is drawn of its support: about the flesh between.
const BACK_GAP = 5;
const SHOULDER_GAP = 34;
const SHAFT = new CylinderGeometry(1, 1, 1, 16).translate(0, 0.5, 0);
const HEAD = new ConeGeometry(1, 1, 20).translate(0, 0.5, 0);

export interface Label {
  at: Vector3;
  text: string;
  kind: "load" | "support" | "level";
  /** The text lies to this side of its place. */
  away: Vector3;
}

/** From `tail` along `direction`, mm. */
class Arrow extends Group {
  private readonly shaft: Mesh;
  private readonly head: Mesh;

  constructor(material: MeshLambertMaterial, private readonly radius: number) {
    super();
    this.shaft = new Mesh(SHAFT, material);
    this.head = new Mesh(HEAD, material);
    this.add(this.shaft, this.head);
  }

  point(tail: Vector3, direction: Vector3, length: number): void {
    const head = Math.min(4.5 * this.radius, 0.6 * length);
    this.position.copy(tail);
    this.quaternion.copy(new Quaternion().setFromUnitVectors(UP, direction));
    this.shaft.scale.set(this.radius, length - head, this.radius);
    this.head.position.set(0, length - head, 0);
    this.head.scale.set(2.2 * this.radius, head, 2.2 * this.radius);
  }
}

export class Marks {
  readonly loads = new Group();
  readonly supports = new Group();
  readonly measured: Sights;
  readonly simulated: Sights;
  private readonly loadMaterial = new MeshLambertMaterial();
  private readonly supportMaterial = new MeshLambertMaterial();
  private readonly plateMaterial = new MeshBasicMaterial({ transparent: true, opacity: 0.42, depthWrite: false });
  private loadArrows: Arrow[] = [];
  private supportArrows: Arrow[] = [];
  private glyphs: Mesh[] = [];
  private push: Push | null = null;

  /** `mmPerN`: of all arrows. */
  constructor(private readonly mmPerN: number) {
    this.simulated = new Sights(3.4, 5, DIAMOND, RING);
    this.measured = new Sights(1.6, 6, CROSS, SALTIRE);
  }

  /** Build what belongs to a push: its arrows, and supports where they are at rest. */
  begin(push: Push, rest: Pose): void {
    this.push = push;
    this.loads.clear();
    this.supports.clear();
    this.loadArrows = push.load.bone.map(() => new Arrow(this.loadMaterial, 3.2));
    this.loads.add(...this.loadArrows);
    this.supportArrows = push.supports.map((support) => new Arrow(this.supportMaterial, isBack(support) ? 1.5 : 2.8));
    this.supports.add(...this.supportArrows);
    this.glyphs = push.supports.map((support) => this.glyph(support, rest));
    this.supports.add(...this.glyphs);
  }

  place(pose: Pose, force: number, reactions: Vector3[]): Label[] {
    if (!this.push) return [];
    return [...this.placeLoads(this.push, pose, force), ...this.placeSupports(this.push, pose, reactions)];
  }

  paint(load: Color, support: Color, measured: Color, simulated: Color): void {
    this.loadMaterial.color.copy(load);
    this.supportMaterial.color.copy(support);
    this.plateMaterial.color.copy(support);
    this.measured.material.color.copy(measured);
    this.simulated.material.color.copy(simulated);
  }

  private placeLoads(push: Push, pose: Pose, force: number): Label[] {
    const tails: Vector3[] = [];
    this.loadArrows.forEach((arrow, i) => {
      const exerted = new Vector3(...push.load.force[i]!).multiplyScalar(force);
      const size = exerted.length();
      arrow.visible = size >= LEAST_N;
      if (!arrow.visible) return;
      const direction = exerted.normalize();
      const tip = onBone(pose, push.load.bone[i]!, push.load.offset[i]!);
      const tail = tip.addScaledVector(direction, -this.mmPerN * size);
      arrow.point(tail, direction, this.mmPerN * size);
      tails.push(tail.clone().addScaledVector(direction, -3));
    });
    if (!tails.length) return [];
    const middle = tails.reduce((sum, tail) => sum.add(tail), new Vector3()).divideScalar(tails.length);
    // Outside of the longest of them.
    const outward = push.side === "left" ? 1 : -1;
    middle.x = outward * Math.max(...tails.map((tail) => outward * tail.x));
    return [{ at: middle, text: newtons(force), kind: "load", away: new Vector3(outward, 0, 0) }];
  }

  private placeSupports(push: Push, pose: Pose, reactions: Vector3[]): Label[] {
    const labels: Label[] = [];
    push.supports.forEach((support, i) => {
      const arrow = this.supportArrows[i]!;
      const force = reactions[i]!;
      const size = force.length();
      const point = onBone(pose, support.bone, support.offset);
      // The back slides along its wall: what is drawn is where they touch. The shoulder's wall stays.
      if (isBack(support)) this.glyphs[i]!.position.copy(point).addScaledVector(outwards(support, point), BACK_GAP);
      arrow.visible = size >= LEAST_N;
      if (!arrow.visible) return;
      const direction = force.clone().divideScalar(size);
      const length = this.mmPerN * size;
      // A support that pulls draws the body towards itself: its arrow starts at the body.
      const pulls = support.direction !== null && direction.dot(outwards(support, point)) > 0;
      const tail = pulls ? point.clone() : point.clone().addScaledVector(direction, -length);
      arrow.point(tail, direction, length);
      if (!isBack(support) && Math.abs(force.x) >= LEAST_N) {
        const away = direction.clone().multiplyScalar(pulls ? 1 : -1);
        const end = point.clone().addScaledVector(away, length + 3);
        labels.push({ at: end, text: newtons(Math.abs(force.x)), kind: "support", away });
      }
    });
    return labels;
  }

  private glyph(support: Support, rest: Pose): Mesh {
    const point = onBone(rest, support.bone, support.offset);
    if (support.direction === null) {
      // The pelvis' hinge: a ring around the axis from front to back.
      const ring = new Mesh(new TorusGeometry(13, 2, 10, 36), this.supportMaterial);
      ring.position.copy(point);
      return ring;
    }
    const along = outwards(support, point);
    const back = isBack(support);
    const plate = new Mesh(back ? new BoxGeometry(13, 13, 1.5) : new BoxGeometry(70, 170, 4), this.plateMaterial);
    plate.position.copy(point).addScaledVector(along, back ? BACK_GAP : SHOULDER_GAP);
    plate.quaternion.setFromUnitVectors(new Vector3(0, 0, 1), along);
    return plate;
  }
}

export function isBack(support: Support): boolean {
  return support.kind === "wall";
}

/** Unit, away from the body: to the shoulder's own side, or backward. */
function outwards(support: Support, point: Vector3): Vector3 {
  const along = new Vector3(...support.direction!);
  const away = isBack(support) ? -1 : Math.sign(point.x) || 1;
  return along.multiplyScalar(away);
}

export function newtons(force: number): string {
  return `${force < 9.95 ? force.toFixed(1) : force.toFixed(0)} N`;
}

/** Segments about a marker, in units of its size. */
type Sign = readonly (readonly [Vector3, Vector3])[];
const AXES = [new Vector3(1, 0, 0), new Vector3(0, 1, 0), new Vector3(0, 0, 1)] as const;
const CROSS: Sign = AXES.map((axis) => [axis.clone().negate(), axis] as const);
const DIAMOND: Sign = AXES.flatMap((axis, i) =>
  [1, -1].flatMap((a) =>
    [1, -1].map((b) => [axis.clone().multiplyScalar(a), AXES[(i + 1) % 3]!.clone().multiplyScalar(b)] as const),
  ),
);
const MARKER_MM = 6;

const BARE: InPlane = { boxes: [], pedicles: [] };

/** Segments about a pedicle in the plane of its radiograph, mm. */
type FlatSign = readonly (readonly [Corner, Corner])[];
const SALTIRE: FlatSign = [[[-2.5, -2.5], [2.5, 2.5]], [[-2.5, 2.5], [2.5, -2.5]]]; // prettier-ignore
const RING_MM = 4;
const RING_SIDES = 16;
const onRing = (i: number): Corner => {
  const turn = (2 * Math.PI * i) / RING_SIDES;
  return [RING_MM * Math.cos(turn), RING_MM * Math.sin(turn)];
};
const RING: FlatSign = Array.from({ length: RING_SIDES }, (_, i) => [onRing(i), onRing(i + 1)] as const);

/** What was seen, or what a model has of it: by view outlines of vertebrae and pedicles, and markers, drawn over everything else. */
export class Sights {
  readonly group = new Group();
  readonly material: LineMaterial;
  private readonly markers: Lines;
  private readonly outlines: { lines: Lines; normal: Vector3 }[] = [];

  /** `order`: the higher is drawn over the lower. `sign`: of a marker. `flat`: of a pedicle. */
  constructor(width: number, private readonly order: number, private readonly sign: Sign, private readonly flat: FlatSign) {
    this.material = new LineMaterial({ linewidth: width, depthTest: false, depthWrite: false, transparent: true });
    this.markers = new Lines(this.material, order);
    this.group.add(this.markers.object);
  }

  draw(push: Push, seen: Seen): void {
    const views: [Plane, InPlane][] = [[push.view, seen.own]];
    for (const [name, plane] of Object.entries(push.further ?? {})) views.push([plane, seen.further[name] ?? BARE]);
    while (this.outlines.length < views.length) {
      const lines = new Lines(this.material, this.order);
      this.group.add(lines.object);
      this.outlines.push({ lines, normal: new Vector3() });
    }
    this.outlines.forEach((outline, i) => {
      const [plane, { boxes, pedicles }] = views[i] ?? [push.view, BARE];
      outline.normal.set(...plane.source).sub(new Vector3(...plane.origin)).normalize();
      const marks = pedicles.flatMap(([u, v]) => this.flat.map(([a, b]): [Corner, Corner] => [[u + a[0], v + a[1]], [u + b[0], v + b[1]]]));
      outline.lines.draw([...boxes.flatMap(sides), ...marks].map(([a, b]): Segment => [inSpace(plane, a), inSpace(plane, b)]));
    });
    const about = (place: Vector3, end: Vector3): Vector3 => place.clone().addScaledVector(end, MARKER_MM);
    this.markers.draw(seen.markers.flatMap((place) => this.sign.map(([a, b]): Segment => [about(place, a), about(place, b)])));
  }

  /** Outlines lie in a plane; from its side they would be a line that says nothing. */
  face(gaze: Vector3): void {
    for (const { lines, normal } of this.outlines) lines.object.visible = lines.any && Math.abs(normal.dot(gaze)) > 0.3;
  }
}

type Segment = [Vector3, Vector3];

class Lines {
  readonly object: LineSegments2;
  any = false;

  constructor(material: LineMaterial, order: number) {
    this.object = new LineSegments2(new LineSegmentsGeometry(), material);
    this.object.frustumCulled = false;
    this.object.visible = false;
    this.object.renderOrder = order;
  }

  draw(segments: Segment[]): void {
    this.object.geometry.dispose();
    this.object.geometry = new LineSegmentsGeometry();
    this.any = segments.length > 0;
    this.object.visible = this.any;
    if (this.any) this.object.geometry.setPositions(segments.flatMap(([a, b]) => [...a.toArray(), ...b.toArray()]));
  }
}

function sides(box: Corner[]): [Corner, Corner][] {
  return box.map((corner, i) => [corner, box[(i + 1) % box.length]!]);
}

/** A point (column, row), mm from where the source's foot lies in the plane. */
function inSpace(plane: Plane, [u, v]: Corner): Vector3 {
  const [columns, rows] = [new Vector3(...plane.columns), new Vector3(...plane.rows)];
  return new Vector3(...plane.origin).addScaledVector(columns, u).addScaledVector(rows, v);
}
