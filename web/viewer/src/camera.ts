// Where the torso is looked at from.
import { Box3, PerspectiveCamera, Spherical, Vector3 } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import type { Vec } from "./scene";

export const VIEWS = ["front", "right", "rear", "left", "tube"] as const;
export type ViewName = (typeof VIEWS)[number];

const DIRECTIONS: Record<Exclude<ViewName, "tube">, Vec> = {
  front: [0, 0, 1],
  right: [-1, 0, 0],
  rear: [0, 0, -1],
  left: [1, 0, 0],
};
export const CAPTIONS: Record<ViewName, string> = {
  front: "From the front: the patient’s left is on your right, as in a frontal radiograph.",
  right: "From the patient’s right: anterior is on your right, as in a lateral radiograph.",
  rear: "From the rear: the patient’s left is on your left.",
  left: "From the patient’s left: anterior is on your left.",
  tube: "From the X-ray tube: model and outlines lie as in this push’s radiographs.",
};
// A person is looked at from about as far as the X-ray source stands.
const FIELD_OF_VIEW = 24;
const TURN = Math.PI / 18;

export class Camera {
  readonly eye = new PerspectiveCamera(FIELD_OF_VIEW, 1, 50, 6000);
  private readonly controls: OrbitControls;
  private readonly centre = new Vector3();
  private readonly size = new Vector3();
  private current: ViewName | null = "front";
  private tube: Vector3 | null = null;

  /** `room`: what must fit in the picture. `changed` is told of every motion, with the view if it is a named one. */
  constructor(canvas: HTMLCanvasElement, room: Box3, private readonly changed: (view: ViewName | null) => void) {
    room.getCenter(this.centre);
    room.getSize(this.size);
    this.controls = new OrbitControls(this.eye, canvas);
    this.controls.enableDamping = false;
    this.controls.enableZoom = false;
    this.controls.minDistance = 150;
    this.controls.maxDistance = 4000;
    // A finger that moves up or down scrolls the page.
    canvas.style.touchAction = "pan-y pinch-zoom";
    this.controls.addEventListener("start", () => (this.current = null));
    this.controls.addEventListener("change", () => this.changed(this.current));
    canvas.addEventListener("keydown", (event) => this.key(event));
    canvas.addEventListener("wheel", (event) => this.wheel(event, canvas), { passive: false });
  }

  setTube(source: Vec | null): void {
    this.tube = source && new Vector3(...source);
    if (this.current === "tube") this.show("tube");
  }

  show(view: ViewName): void {
    if (view === "tube" && !this.tube) return;
    this.current = view;
    const centre = this.controls.target.copy(this.centre);
    if (view === "tube") this.eye.position.copy(this.tube!);
    else this.eye.position.copy(centre).addScaledVector(new Vector3(...DIRECTIONS[view]), this.distance(view));
    this.eye.zoom = view === "tube" ? this.tube!.distanceTo(centre) / this.distance("front") : 1;
    this.eye.updateProjectionMatrix();
    this.controls.update();
    this.changed(view);
  }

  resize(width: number, height: number): void {
    this.eye.aspect = width / height;
    this.eye.updateProjectionMatrix();
    if (this.current) this.show(this.current);
    else this.changed(null);
  }

  zoom(factor: number): void {
    this.eye.zoom = Math.min(Math.max(this.eye.zoom * factor, 0.4), 12);
    this.eye.updateProjectionMatrix();
    this.changed(this.current);
  }

  /** The letters of what lies to the picture's right, e.g. "L" from the front, "LA" obliquely. */
  rightLetters(): string {
    const right = new Vector3().setFromMatrixColumn(this.eye.matrixWorld, 0);
    const parts: [number, string][] = [
      [Math.abs(right.x), right.x > 0 ? "L" : "R"],
      [Math.abs(right.z), right.z > 0 ? "A" : "P"],
    ];
    parts.sort((a, b) => b[0] - a[0]);
    return parts.filter(([size]) => size > 0.35).map(([, letter]) => letter).join("");
  }

  private distance(view: Exclude<ViewName, "tube">): number {
    const sideways = view === "front" || view === "rear";
    const [width, depth] = sideways ? [this.size.x, this.size.z] : [this.size.z, this.size.x];
    const half = Math.tan(((FIELD_OF_VIEW / 2) * Math.PI) / 180);
    return Math.max(this.size.y / 2 / half, width / 2 / half / this.eye.aspect) + 0.5 * depth;
  }

  private key(event: KeyboardEvent): void {
    const turns: Record<string, [number, number]> = {
      ArrowLeft: [-TURN, 0],
      ArrowRight: [TURN, 0],
      ArrowUp: [0, -TURN],
      ArrowDown: [0, TURN],
    };
    const turn = turns[event.key];
    if (turn) this.turn(...turn);
    else if (event.key === "+" || event.key === "=") this.zoom(1.2);
    else if (event.key === "-") this.zoom(1 / 1.2);
    else return;
    event.preventDefault();
  }

  private turn(around: number, over: number): void {
    this.current = null;
    const target = this.controls.target;
    const place = new Spherical().setFromVector3(this.eye.position.clone().sub(target));
    place.theta += around;
    place.phi += over;
    place.makeSafe();
    this.eye.position.setFromSpherical(place).add(target);
    this.controls.update();
    this.changed(null);
  }

  private wheel(event: WheelEvent, canvas: HTMLCanvasElement): void {
    // Only where the picture has been chosen, so that a page with it can be scrolled past.
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    this.zoom(Math.exp(-Math.sign(event.deltaY) * 0.1));
  }
}
