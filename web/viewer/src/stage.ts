// The picture: a scene on a canvas, drawn again only when something changed.
import { AmbientLight, Box3, DirectionalLight, Scene as Stage3, Vector3, WebGLRenderer } from "three";
import { h } from "../../shared/dom";
import { Body } from "./body";
import { Camera, CAPTIONS, VIEWS, type ViewName } from "./camera";
import { type Label, Marks } from "./marks";
import { readPalette } from "./palette";
import { type InPlane, onBone, type Pose, restPose } from "./pose";
import type { Push, Scene } from "./scene";

export const LAYERS = [
  "bones", "skin", "joints", "levels", "loads", "supports", "measured", "simulated", "rest",
] as const; // prettier-ignore
export type Layer = (typeof LAYERS)[number];
const LONGEST_ARROW_MM = 105;
const TURNED = "Turned freely; the letters say which side of the patient lies where.";

/** What lies in the plane of the push's own view and of further ones, and markers on the skin. */
export interface Seen {
  own: InPlane;
  further: Record<string, InPlane>;
  markers: Vector3[];
}

export const NOTHING: Seen = { own: { boxes: [], pedicles: [] }, further: {}, markers: [] };

export interface Shown {
  push: Push | null;
  pose: Pose;
  force: number;
  reactions: Vector3[];
  measured: Seen;
  simulated: Seen;
}

export interface Parts {
  root: HTMLElement;
  canvas: HTMLCanvasElement;
  labels: HTMLElement;
  sides: [HTMLElement, HTMLElement];
  caption: HTMLElement;
  buttons: HTMLElement[];
}

export class Stage {
  readonly camera: Camera;
  readonly rest: Pose;
  private readonly renderer: WebGLRenderer;
  private readonly world = new Stage3();
  private readonly body: Body;
  private readonly marks: Marks;
  private readonly on = new Set<Layer>();
  private readonly spans: HTMLSpanElement[] = [];
  private marked: Label[] = [];
  private shown: Shown;
  private began: Push | null = null;
  private waiting = false;

  constructor(private readonly scene: Scene, private readonly parts: Parts) {
    // The buffer is kept so that what is printed is what was drawn.
    this.renderer = new WebGLRenderer({ canvas: parts.canvas, antialias: true, alpha: true, preserveDrawingBuffer: true });
    this.renderer.setClearAlpha(0);
    this.rest = restPose(scene);
    this.shown = { push: null, pose: this.rest, force: 0, reactions: [], measured: NOTHING, simulated: NOTHING };
    this.body = new Body(scene, this.rest);
    const most = Math.max(...scene.pushes.flatMap((push) => push.frames.map((frame) => frame.force)), 1);
    this.marks = new Marks(LONGEST_ARROW_MM / most);
    const { bones, skin, joints, rest } = this.body;
    const { loads, supports, measured, simulated } = this.marks;
    this.world.add(bones, skin, joints, rest, loads, supports, simulated.group, measured.group);
    this.camera = new Camera(parts.canvas, this.room(), (view) => this.looked(view));
    // The light comes with the viewer, from over the left shoulder: no side of the torso is dark.
    const light = new DirectionalLight(0xffffff, 2.1);
    light.position.set(-400, 500, 600);
    this.camera.eye.add(light, light.target);
    light.target.position.set(0, 0, -1000);
    this.world.add(this.camera.eye, new AmbientLight(0xffffff, 1.15));
    this.paint();
    this.watch();
    this.camera.show("front");
  }

  layer(name: Layer, on: boolean): void {
    if (on) this.on.add(name);
    else this.on.delete(name);
    this.update(this.shown);
  }

  update(shown: Shown): void {
    this.shown = shown;
    const { push, pose } = shown;
    if (push && push !== this.began) {
      this.marks.begin(push, this.rest);
      this.camera.setTube(push.view.source);
      this.began = push;
    }
    this.body.place(pose);
    const { bones, skin, joints, rest } = this.body;
    for (const [name, object] of Object.entries({ bones, skin, joints, rest })) object.visible = this.on.has(name as Layer);
    const labels = this.marks.place(pose, shown.force, shown.reactions);
    this.marks.loads.visible = this.on.has("loads");
    this.marks.supports.visible = this.on.has("supports");
    this.marked = labels.filter((label) => this.on.has(label.kind === "load" ? "loads" : "supports"));
    if (this.on.has("levels")) this.marked.push(...this.levels(pose));
    if (push) {
      this.marks.measured.draw(push, this.on.has("measured") ? shown.measured : NOTHING);
      this.marks.simulated.draw(push, this.on.has("simulated") ? shown.simulated : NOTHING);
    }
    this.faceOutlines();
    this.ask();
  }

  /** Draw now, e.g. before the page is printed. */
  draw(): void {
    this.waiting = false;
    this.renderer.render(this.world, this.camera.eye);
    this.write();
  }

  paint(): void {
    const palette = readPalette(this.parts.root);
    this.body.paint(palette);
    this.marks.paint(palette.load, palette.support, palette.measured, palette.simulated);
    this.ask();
  }

  private ask(): void {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => this.draw());
  }

  private looked(view: ViewName | null): void {
    for (const button of this.parts.buttons) button.setAttribute("aria-pressed", String(button.dataset["view"] === view));
    this.parts.caption.textContent = view ? CAPTIONS[view] : TURNED;
    this.faceOutlines();
    this.ask();
  }

  private faceOutlines(): void {
    if (!this.shown.push) return;
    const gaze = this.camera.eye.getWorldDirection(new Vector3());
    for (const sights of [this.marks.measured, this.marks.simulated]) sights.face(gaze);
  }

  private watch(): void {
    const { canvas, buttons } = this.parts;
    const fit = (): void => {
      const { clientWidth: width, clientHeight: height } = canvas;
      if (!width || !height) return;
      this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
      this.renderer.setSize(width, height, false);
      this.camera.resize(width, height);
      this.draw();
    };
    new ResizeObserver(fit).observe(canvas);
    fit();
    for (const button of buttons) {
      const view = VIEWS.find((name) => name === button.dataset["view"]);
      if (view) button.addEventListener("click", () => this.camera.show(view));
    }
    for (const query of ["(prefers-color-scheme: dark)", "print"]) {
      matchMedia(query).addEventListener("change", () => {
        this.paint();
        fit();
      });
    }
    canvas.addEventListener("webglcontextrestored", () => this.ask());
  }

  /** What the picture must hold: the torso, its arrows at both sides. */
  private room(): Box3 {
    this.body.bones.updateMatrixWorld(true);
    const room = new Box3().setFromObject(this.body.bones);
    for (const skin of this.scene.skins) if (skin.length) room.union(new Box3().setFromArray(skin));
    const aside = this.scene.pushes.length ? 0.85 * LONGEST_ARROW_MM : 10;
    return room.expandByVector(new Vector3(aside, 14, this.scene.pushes.length ? 30 : 10));
  }

  private levels(pose: Pose): Label[] {
    return this.scene.bones.flatMap((bone, i): Label[] =>
      bone.kind === "vertebra" ? [{ at: onBone(pose, i, [0, 0, 0]), text: bone.name, kind: "level", away: new Vector3() }] : [],
    );
  }

  /** Labels are text over the picture: sharp, and selectable by nobody. */
  private write(): void {
    const { labels, canvas, sides } = this.parts;
    const { clientWidth: width, clientHeight: height } = canvas;
    this.camera.eye.updateMatrixWorld();
    const right = new Vector3().setFromMatrixColumn(this.camera.eye.matrixWorld, 0);
    const gaze = this.camera.eye.getWorldDirection(new Vector3());
    while (this.spans.length < this.marked.length) this.spans.push(labels.appendChild(h("span")));
    this.spans.forEach((span, i) => {
      const label = this.marked[i];
      // An arrow seen from its end shows no length; its number would belong to nothing.
      const endOn = label && label.kind !== "level" && label.away.clone().cross(gaze).length() < 0.35;
      span.hidden = !label || Boolean(endOn);
      if (!label || endOn) return;
      const at = label.at.clone();
      // Beside the vertebra, clear of its outline.
      if (label.kind === "level") at.addScaledVector(right, 33);
      const side = label.kind === "level" ? 1 : label.away.dot(right);
      const align = side > 0.3 ? "0" : side < -0.3 ? "-100%" : "-50%";
      const seen = at.project(this.camera.eye);
      span.textContent = label.text;
      span.className = `v-of-${label.kind}`;
      const x = (0.5 + 0.5 * seen.x) * width;
      const y = (0.5 - 0.5 * seen.y) * height;
      span.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px) translate(${align}, -50%)`;
    });
    const letters = this.camera.rightLetters();
    const opposite: Record<string, string> = { L: "R", R: "L", A: "P", P: "A" };
    sides[1].textContent = letters;
    sides[0].textContent = [...letters].map((letter) => opposite[letter]).join("");
  }
}
