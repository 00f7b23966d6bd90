// The slider, the choices and the numbers; they work without a picture, too.
import { Vector3 } from "three";
import { h } from "../../shared/dom";
import { isBack, newtons } from "./marks";
import { bracket, furtherAt, markersAt, planeAt, poseAt, reactionsAt, restPose, type Bracket, type Pose } from "./pose";
import type { Corner, Frame, Push, Scene, Step } from "./scene";
import { LAYERS, type Layer, NOTHING, type Seen, type Shown, type Stage } from "./stage";

const ROLES: Record<string, string> = { training: "training", validation: "held out", unused: "not used" };
// Of the slider, N; it stands on a measured frame that is not farther away than half of it.
const STEP = 0.5;

export class Panel {
  private readonly force: HTMLInputElement | null;
  private readonly push: HTMLSelectElement | null;
  private readonly model: HTMLSelectElement | null;
  private readonly rest: Pose;
  private frame: number | null = null;
  private last: Shown;
  stage: Stage | null = null;

  constructor(private readonly root: HTMLElement, private readonly scene: Scene) {
    this.rest = restPose(scene);
    this.last = { push: null, pose: this.rest, force: 0, reactions: [], measured: NOTHING, simulated: NOTHING };
    this.force = this.part<HTMLInputElement>("force");
    this.push = this.part<HTMLSelectElement>("push");
    this.model = this.part<HTMLSelectElement>("model");
    this.force?.addEventListener("input", () => this.slid());
    this.push?.addEventListener("change", () => this.begin());
    this.model?.addEventListener("change", () => this.refresh());
    this.part("before")?.addEventListener("click", () => this.go(-1));
    this.part("after")?.addEventListener("click", () => this.go(1));
    this.part("in")?.addEventListener("click", () => this.stage?.camera.zoom(1.2));
    this.part("out")?.addEventListener("click", () => this.stage?.camera.zoom(1 / 1.2));
    for (const box of this.boxes()) {
      box.addEventListener("change", () => this.stage?.layer(box.dataset["show"] as Layer, box.checked));
    }
    this.begin();
  }

  part<T extends HTMLElement>(role: string): T | null {
    return this.root.querySelector<T>(`[data-role="${role}"]`);
  }

  /** The picture is there: show in it what is chosen. */
  connect(stage: Stage): void {
    this.stage = stage;
    for (const box of this.boxes()) stage.layer(box.dataset["show"] as Layer, box.checked);
    stage.update(this.last);
  }

  /** Where a bone is, for whoever automates the page: mm and a unit quaternion. */
  bone(name: string): { place: number[]; turn: number[] } | null {
    const i = this.scene.bones.findIndex((bone) => bone.name === name);
    if (i < 0) return null;
    return { place: this.last.pose.places[i]!.toArray(), turn: this.last.pose.turns[i]!.toArray() };
  }

  setForce(force: number): void {
    if (!this.force) return;
    this.force.value = String(force);
    this.slid();
  }

  private boxes(): HTMLInputElement[] {
    const known: readonly string[] = LAYERS;
    return [...this.root.querySelectorAll<HTMLInputElement>("[data-show]")].filter((box) => known.includes(box.dataset["show"] ?? ""));
  }

  private get chosen(): Push | null {
    return this.scene.pushes.find((push) => push.id === this.push?.value) ?? this.scene.pushes[0] ?? null;
  }

  private get steps(): Step[] {
    const models = this.chosen?.models ?? {};
    return models[this.model?.value ?? "fit"] ?? Object.values(models)[0] ?? [];
  }

  private get limit(): number {
    return Math.max(...(this.chosen?.frames ?? []).map((frame) => frame.force), 0);
  }

  /** A push was chosen: its full load is shown. */
  private begin(): void {
    if (!this.force || !this.chosen) return;
    const limit = this.limit;
    this.force.step = String(STEP);
    this.force.max = String(STEP * Math.ceil(limit / STEP));
    this.frame = this.chosen.frames.find((frame) => frame.force === limit)?.frame ?? null;
    const ticks = this.part("ticks");
    const forces = [...new Set(this.chosen.frames.map((frame) => frame.force))];
    let labelled = -1;
    const spans = forces.map((force) => {
      const span = h("span");
      // A number only where there is room for it.
      if (labelled < 0 || force - labelled > 0.08 * limit) {
        span.textContent = String(Math.round(force));
        labelled = force;
      }
      span.style.left = `${(100 * force) / (limit || 1)}%`;
      return span;
    });
    ticks?.replaceChildren(...spans);
    this.force.value = String(limit);
    this.refresh();
  }

  private slid(): void {
    this.frame = null;
    this.refresh();
  }

  /** To the measured frame before or after the one shown. */
  private go(by: 1 | -1): void {
    const frames = this.chosen?.frames ?? [];
    const force = this.shownForce();
    const here = frames.findIndex((frame) => frame === this.current(force));
    let next: Frame | undefined;
    if (here >= 0) next = frames[here + by];
    else if (by > 0) next = frames.find((frame) => frame.force > force);
    else next = [...frames].reverse().find((frame) => frame.force < force);
    if (!next || !this.force) return;
    this.frame = next.frame;
    this.force.value = String(next.force);
    this.refresh();
  }

  /** The slider's own steps may miss a frame's force by a hair; of several frames that near the chosen one counts. */
  private shownForce(): number {
    const value = Math.min(Number(this.force?.value ?? 0), this.limit);
    const away = (frame: Frame): number => Math.abs(frame.force - value);
    const near = (this.chosen?.frames ?? []).filter((frame) => away(frame) <= STEP / 2).sort((a, b) => away(a) - away(b));
    return (near.find((frame) => frame.frame === this.frame) ?? near[0])?.force ?? value;
  }

  private current(force: number): Frame | null {
    const same = (this.chosen?.frames ?? []).filter((frame) => frame.force === force);
    return same.find((frame) => frame.frame === this.frame) ?? same[0] ?? null;
  }

  private refresh(): void {
    const push = this.chosen;
    if (!push || !this.steps.length) return;
    const force = this.shownForce();
    const frame = this.current(force);
    const where = bracket(this.steps, force, frame?.frame ?? null);
    const beyond = force > where.after.force + 1e-9;
    this.last = {
      push,
      pose: poseAt(this.scene, where),
      force: beyond ? where.after.force : force,
      reactions: reactionsAt(where),
      measured: frame ? measuredIn(frame) : NOTHING,
      simulated: beyond
        ? NOTHING
        : { own: planeAt(where), further: furtherAt(where), markers: markersAt(where) },
    };
    this.stage?.update(this.last);
    this.describe(push, force, frame, where, beyond);
  }

  private describe(push: Push, force: number, frame: Frame | null, where: Bracket, beyond: boolean): void {
    const model = this.model?.value ?? Object.keys(push.models)[0] ?? "fit";
    const error = frame?.rmse[model];
    const number = `${force.toFixed(Number.isInteger(force) ? 0 : 1)} N`;
    const role = frame ? `frame ${frame.frame}, ${ROLES[frame.role] ?? frame.role}` : "";
    let words = role;
    if (beyond) words = `${role ? `${role}; ` : ""}no equilibrium above ${where.after.force} N`;
    else if (!frame && force === 0) words = "at rest; no frame without force";
    else if (!frame) words = `between ${where.before.force} N and ${where.after.force} N`;
    else if (where.share > 0) words = `${role}; no equilibrium found here, interpolated`;
    else if (force === 0) words = `at rest; ${role}`;
    this.text("force-text", number);
    // What paper needs instead of the panel.
    const title = this.model?.selectedOptions[0]?.textContent ?? "";
    const drawn = "Outlines: measured blue, simulated orange. Push red, reactions green.";
    this.text("printed", [`Push ${push.id}, ${number}`, words, title].filter(Boolean).join("; ") + `. ${drawn}`);
    this.text("frame-text", words);
    this.force!.setAttribute("aria-valuetext", `${number}, ${words}`);
    this.root.dataset["force"] = String(force);
    this.root.dataset["frame"] = frame ? String(frame.frame) : "";
    const facts: [string, string][] = [["Corner RMSE", error === undefined ? "–" : `${error.toFixed(1)} mm`]];
    facts.push(["Largest motion", this.farthest()]);
    push.load.bone.forEach((bone, i) => {
      const size = force * new Vector3(...push.load.force[i]!).length();
      if (size >= 0.05) facts.push([`Push on ${ribWords(this.scene.bones[bone]!.name)}`, newtons(size)]);
    });
    facts.push(...this.supportFacts(push));
    facts.push(...this.pelvisFact());
    const list = this.part("facts");
    list?.replaceChildren(...facts.flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, value)]));
    const frames = push.frames;
    const here = frame ? frames.indexOf(frame) : -1;
    this.enable("before", frame ? here > 0 : frames.some((other) => other.force < force));
    this.enable("after", frame ? here < frames.length - 1 : frames.some((other) => other.force > force));
  }

  private farthest(): string {
    let found = { name: "", by: 0 };
    this.scene.bones.forEach((bone, i) => {
      const by = this.last.pose.places[i]!.x - this.rest.places[i]!.x;
      if (bone.kind === "vertebra" && Math.abs(by) > Math.abs(found.by)) found = { name: bone.name, by };
    });
    return Math.abs(found.by) < 0.05 ? "–" : `${found.name}, ${sideways(found.by, "mm")}`;
  }

  /** How far the pelvis has turned about the axis from rear to front. */
  private pelvisFact(): [string, string][] {
    const i = this.scene.bones.findIndex((bone) => bone.name === "pelvis");
    if (i < 0) return [];
    const turn = this.last.pose.turns[i]!.clone().multiply(this.rest.turns[i]!.clone().invert());
    const left = new Vector3(1, 0, 0).applyQuaternion(turn);
    const degrees = (Math.atan2(left.y, left.x) * 180) / Math.PI;
    if (Math.abs(degrees) < 0.05) return [["Pelvis tilts", "0°"]];
    return [["Pelvis tilts", `${Math.abs(degrees).toFixed(1)}°, ${degrees > 0 ? "left" : "right"} side up`]];
  }

  private supportFacts(push: Push): [string, string][] {
    const facts: [string, string][] = [];
    const wall = { pushes: 0, pulls: 0, pulling: 0 };
    push.supports.forEach((support, i) => {
      const force = this.last.reactions[i]!;
      if (isBack(support)) {
        if (force.z >= 0) wall.pushes += force.z;
        else {
          wall.pulls -= force.z;
          if (force.z < -0.5) wall.pulling += 1;
        }
      } else {
        const name = support.kind === "shoulder" ? support.kind : support.name;
        facts.push([`${capital(name)} on torso`, Math.abs(force.x) < 0.05 ? "0 N" : sideways(force.x, "N")]);
      }
    });
    if (push.supports.some(isBack)) {
      facts.push(["Back wall, pushing", `${wall.pushes.toFixed(0)} N`]);
      if (wall.pulling) facts.push(["Back wall, pulling", `${wall.pulls.toFixed(0)} N at ${wall.pulling} points`]);
    }
    return facts;
  }

  private text(role: string, words: string): void {
    const found = this.part(role);
    if (found && found.textContent !== words) found.textContent = words;
  }

  private enable(role: string, on: boolean): void {
    const button = this.part<HTMLButtonElement>(role);
    if (button) button.disabled = !on;
  }
}

function measuredIn(frame: Frame): Seen {
  const marked = (pedicles: Frame["pedicles"]): Corner[] => Object.values(pedicles ?? {});
  const further = Object.entries(frame.outlines ?? {}).map(([view, seen]) => [view, { boxes: seen.boxes, pedicles: marked(seen.pedicles) }]);
  const markers = Object.values(frame.markers ?? {}).map((place) => new Vector3(...place));
  return { own: { boxes: frame.measured, pedicles: marked(frame.pedicles) }, further: Object.fromEntries(further), markers };
}

function sideways(size: number, unit: string): string {
  return `${Math.abs(size).toFixed(1)} ${unit} ${size > 0 ? "left" : "right"}`;
}

function capital(words: string): string {
  return words.charAt(0).toUpperCase() + words.slice(1);
}

function ribWords(bone: string): string {
  const match = /^R(\d+)_([LR])$/.exec(bone);
  return match ? `rib ${match[1]} ${match[2] === "L" ? "left" : "right"}` : bone.replaceAll("_", " ");
}
