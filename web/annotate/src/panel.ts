// The controls around the radiograph: what they show follows the state, what they do is asked of it.
import { button, h, need } from "../../shared/dom";
import * as api from "./api";
import { type App, type Says, type Tool } from "./app";
import { KEYS } from "./keys";

const TOOLS: Record<Tool, [string, string]> = {
  move: ["Move", "Drag corners or whole vertebrae; drag beside them to move the picture."],
  spine: ["Spine points", "Click the middle of the uppermost vertebra, a few points along the spine, and the middle of the lowest. Say under Spine which two they are, then propose."],
  pelvis: ["Pelvis", "Click points on the pelvis, left and right alike; they show whether it moved under the push."],
  shoulder: ["Shoulder", "Click a point on the shoulder that rests against its pad, opposite the push; it shows whether it moved."],
  pedicle: ["Pedicles", "Click the middle of a pedicle’s shadow; it goes to the nearest vertebra. The other one is guessed, dotted, until you click, choose or drag it, too. Optional."],
};

/** The fields of the spine's ends. */
const ENDS = ["upper", "lower"] as const;

function put(id: string, text: string): void {
  const element = need(id);
  if (element.textContent !== text) element.textContent = text;
}

/** Tells when the cause of the problem in sight is gone; null without one. */
let standing: (() => boolean) | null = null;

/** What can be said before there is a state. */
export const says: Says = {
  saved: (state, text) => { need("saved").dataset["state"] = state; put("saved", text); },
  // One place for both, of one size: the picture stays where it is.
  problem: (text, gone = () => false) => {
    standing = text ? gone : null;
    need("problem").hidden = !text;
    need("hint").hidden = !!text;
    put("problem", text);
  },
  aloud: (text) => put("spoken", text),
  refresh: () => undefined,
};

/** In the workbench, the way to what comes after the marks. */
function onward(): Node | string {
  const key = /^\/annotate\/([^/]+)\/$/.exec(location.pathname)?.[1];
  return key ? h("a", { href: `/#/subject/${key}/run`, id: "onward" }, "Go on to the run") : "";
}

export class Panel {
  private readonly images = new Map<string, [HTMLButtonElement, HTMLElement, HTMLElement]>();
  private readonly vertebrae = new Map<string, [HTMLButtonElement, HTMLInputElement]>();
  private toolKey = "";

  constructor(private readonly app: App) {
    put("subject", app.session.subject);
    this.makeImages();
    this.makeVertebrae();
    for (const [i, id] of ENDS.entries()) {
      const select = need<HTMLSelectElement>(id);
      for (const name of app.names) select.add(new Option(name, name));
      select.addEventListener("change", () => app.setEnd(i as 0 | 1, select.value));
    }
    const click = (id: string, act: () => void): void => need(id).addEventListener("click", act);
    click("undo", () => app.undo());
    click("redo", () => app.redo());
    click("closer", () => app.stage.zoom(1.25));
    click("further", () => app.stage.zoom(0.8));
    click("fit", () => app.stage.fit());
    click("propose", () => void app.propose());
    click("look-on", () => { app.lookOn(); app.stage.canvas.focus(); });
    click("clear-spine", () => app.clearSpine());
    click("names-up", () => app.rename(-1));
    click("names-down", () => app.rename(1));
    click("track", () => void app.track());
    click("frame-back", () => void app.open(app.image.name, app.frame - 1));
    click("frame-on", () => void app.open(app.image.name, app.frame + 1));
    click("export-csv", () => void this.export("csv"));
    click("export-slicer", () => void this.export("slicer"));
    click("grey", () => { app.stage.setWindow([...app.stage.natural]); this.refresh(); });
    need("frame").addEventListener("input", () => void app.open(app.image.name, Number(need<HTMLInputElement>("frame").value)));
    need("show").addEventListener("change", () => { app.show = need<HTMLInputElement>("show").checked; app.after(); });
    for (const id of ["level", "width"]) need(id).addEventListener("input", () => this.greys());
    need("import").addEventListener("change", () => void this.import());
    need("keys").append(...KEYS.flatMap(([keys, what]) => [h("dt", {}, keys), h("dd", {}, what)]));
  }

  private makeImages(): void {
    for (const image of this.app.session.images) {
      const mark = h("span", { "aria-hidden": "true" }), state = h("small"), made = button("", () => void this.app.open(image.name));
      made.append(mark, h("span", {}, image.title), state);
      need("images").append(h("li", {}, made));
      this.images.set(image.name, [made, mark, state]);
    }
  }

  private makeVertebrae(): void {
    for (const name of this.app.names) {
      const box = h("input", { type: "checkbox", "aria-label": `${name} visible` });
      const made = button(name, () => {
        this.app.choose("move");
        this.app.select({ kind: "vertebra", name, part: -1 });
        this.app.stage.canvas.focus();
      });
      box.addEventListener("change", () => this.app.visible(name, box.checked));
      need("vertebrae").append(h("li", {}, h("label", { title: `${name} visible` }, box), made));
      this.vertebrae.set(name, [made, box]);
    }
  }

  private makeTools(): void {
    const { app } = this, key = app.tools.join();
    if (key !== this.toolKey) {
      this.toolKey = key;
      const group = need("tools");
      group.replaceChildren(...app.tools.map((tool) => {
        const made = button(TOOLS[tool][0], () => { app.choose(tool); app.stage.canvas.focus(); }, { role: "radio", "data-tool": tool });
        made.addEventListener("keydown", (event) => {
          const by = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
          if (!by) return;
          event.preventDefault();
          const next = app.tools[(app.tools.indexOf(tool) + by + app.tools.length) % app.tools.length] as Tool;
          app.choose(next);
          group.querySelector<HTMLElement>(`[data-tool="${next}"]`)?.focus();
        });
        return made;
      }));
    }
    for (const made of need("tools").querySelectorAll<HTMLElement>("button")) {
      const on = made.dataset["tool"] === app.tool;
      made.setAttribute("aria-checked", String(on));
      made.tabIndex = on ? 0 : -1;
    }
    put("hint", TOOLS[app.tool][1]);
    const canvas = app.stage.canvas;
    canvas.dataset["tool"] = app.tool;
    canvas.dataset["adds"] = String(app.tool !== "move");
  }

  refresh(): void {
    const { app } = this, { marks } = app;
    if (standing?.()) says.problem("");
    this.makeTools();
    for (const [i, id] of ENDS.entries()) {
      need<HTMLSelectElement>(id).value = app.ends[i as 0 | 1];
      need<HTMLSelectElement>(id).disabled = app.frame > 0;
    }
    for (const [name, [made, mark, state]] of this.images) {
      const n = Object.keys(app.allMarks[name]?.vertebrae ?? {}).length;
      const open = app.missing.some((line) => line.startsWith(`${name}:`)), unseen = app.unseenIn(name);
      mark.textContent = n === 0 ? "○" : open || unseen ? "◐" : "✓";
      state.textContent = n === 0 ? "nothing marked" : `${n} vertebrae${unseen ? `, ${unseen} to look at` : open ? ", not complete" : ""}`;
      if (name === app.image.name) made.setAttribute("aria-current", "true"); else made.removeAttribute("aria-current");
    }
    const shown = app.seen.vertebrae, unseen = app.unseen;
    for (const [name, [made, box]] of this.vertebrae) {
      const there = name in shown;
      made.disabled = !there;
      made.dataset["unseen"] = String(unseen.includes(name));
      made.title = unseen.includes(name) ? `${name}: proposed, not looked at yet` : name;
      made.setAttribute("aria-pressed", String(app.selection?.kind === "vertebra" && app.selection.name === name));
      box.checked = there;
      box.disabled = app.frame > 0;
    }
    this.off("look-on", !unseen.length);
    put("look-on", unseen.length ? `Next to look at (${unseen.length} left)` : "Next to look at");
    this.off("undo", !app.canUndo);
    this.off("redo", !app.canRedo);
    for (const id of ["names-up", "names-down"]) this.off(id, app.frame > 0);
    this.off("clear-spine", !marks.spine.length);
    this.off("propose", !!app.busy || app.frame > 0);
    put("propose", app.busy || (app.allKept ? "Propose all anew" : Object.keys(app.kept).length ? "Propose the others" : "Propose vertebrae"));
    put("spine-text", app.frame ? "Later frames are tracked." : `${marks.spine.length === 1 ? "1 point" : `${marks.spine.length} points`} along it${marks.spine.length < 3 ? "; a proposal needs three" : ""}.`);
    this.cobb();
    this.frames();
    this.missing();
    this.sliders();
    app.stage.canvas.setAttribute("aria-label", `${app.image.title}, ${Object.keys(shown).length} vertebrae marked`);
  }

  /** A button that can't be pressed now hands the focus to the radiograph, where keys do the same. */
  private off(id: string, off: boolean): void {
    const made = need<HTMLButtonElement>(id);
    if (off && document.activeElement === made) this.app.stage.canvas.focus();
    made.disabled = off;
  }

  private cobb(): void {
    const { cobb, curves, image, judged, seen } = this.app, target = need("cobb");
    // Size and uncertainty large, levels, definition and side behind them.
    const [figures, behind] = cobb ? (cobb.words.split(/(?= \()/) as [string, string?]) : [];
    const text = figures ?? (image.kind === "lateral" ? "Read in frontal radiographs." : this.app.outdated ? "Read once it is tracked." : Object.keys(seen.vertebrae).length < 2 ? "Needs two vertebrae." : "Not read."), rest = behind ?? "";
    const others = curves.filter((one) => one.words !== cobb?.words).map((one) => `${one.words}, ${one.region}`);
    const key = [text, rest, judged, ...others].join("\n");
    if (target.dataset["key"] === key) return;
    target.dataset["key"] = key;
    target.replaceChildren(h(cobb ? "b" : "span", {}, text), rest);
    const add = (words_: string): void => target.append(h("br"), h("span", { class: "note" }, words_));
    others.forEach(add);
    if (judged && Object.keys({ ...this.app.marks.vertebrae, ...this.app.marks.pedicles }).length) add(judged);
  }

  private frames(): void {
    const { app } = this, { image, frame } = app, count = image.forces.length;
    need("frames").hidden = count < 2;
    if (count < 2) return;
    const slider = need<HTMLInputElement>("frame");
    slider.max = String(count - 1);
    slider.value = String(frame);
    const force = image.forces[frame] ?? null;
    const words_ = `${frame} (0 to ${count - 1}), ${force === null ? "force not known yet" : `${force} N`}, ${image.roles[frame] ?? ""}`;
    slider.setAttribute("aria-valuetext", words_);
    const state = app.tracking[image.name], here = Object.keys(app.marks.vertebrae).length;
    const others = app.outdated ? "tracked before the last change, being tracked anew" : app.tracked ? "tracked" : "not tracked yet";
    const source = frame === 0 ? "marked" : here ? `${here} corrected, the others ${others}` : others;
    const own = app.marks.vertebrae, tracked = Object.entries(app.tracked?.quality ?? {}).filter(([name]) => !(name in own));
    const doubtful = tracked.flatMap(([, quality]) => quality).filter((q) => q < app.session.lowest_quality).length;
    const pairs = Object.keys(app.marks.pedicles).length, pedicles = pairs ? `, pedicles of ${pairs} marked` : "";
    put("frame-text", `Frame ${words_}: ${source}${doubtful && !app.outdated ? `, ${doubtful} corners doubtful or lost` : ""}${pedicles}`);
    this.off("frame-back", frame === 0);
    this.off("frame-on", frame === count - 1);
    const running = state?.state === "running", bar = need<HTMLProgressElement>("track-progress");
    this.off("track", running);
    bar.style.visibility = running ? "visible" : "hidden";
    need("frame-text").title = need("frame-text").textContent ?? "";
    if (running) bar.value = state.done / Math.max(1, state.total);
  }

  private missing(): void {
    const { app } = this, target = need("missing"), key = app.missing.join("\n");
    if (target.dataset["key"] === key) return;
    target.dataset["key"] = key;
    target.dataset["state"] = app.missing.length ? "open" : "whole";
    if (!app.missing.length) return target.replaceChildren("✓ Everything a fit needs is marked.", onward());
    const lines = app.missing.map((line) => {
      const name = line.slice(0, line.indexOf(":")), image = app.session.images.find((one) => one.name === name);
      return h("li", {}, image ? `${image.title}: ${line.slice(name.length + 2)}` : line);
    });
    target.replaceChildren(h("b", {}, "Still needed for a fit"), h("ul", {}, ...lines));
  }

  // Level and width of the window as shares of the radiograph's own range.
  private sliders(): void {
    const [low, high] = this.app.stage.window;
    const active = document.activeElement;
    if (active !== need("level")) need<HTMLInputElement>("level").value = String(100 - (50 * (low + high)) / 65535);
    if (active !== need("width")) need<HTMLInputElement>("width").value = String(100 - (100 * Math.min(65535, high - low)) / 65535);
  }

  private greys(): void {
    const middle = ((100 - Number(need<HTMLInputElement>("level").value)) / 100) * 65535;
    const size = Math.max(200, ((100 - Number(need<HTMLInputElement>("width").value)) / 100) * 65535);
    this.app.stage.setWindow([middle - 0.5 * size, middle + 0.5 * size]);
  }

  private async import(): Promise<void> {
    const input = need<HTMLInputElement>("import"), file = input.files?.[0];
    if (!file) return;
    const { app } = this;
    await app.whileBusy("Reading …", async () => {
      const found = await api.importFile(file.name, await file.text(), app.key);
      app.replace({ ...app.allMarks, ...found.marks }, `import of ${Object.keys(found.marks).length} radiographs`);
      if (found.warnings.length) app.problem(found.warnings.join(" "));
    });
    input.value = "";
  }

  private async export(form: "csv" | "slicer"): Promise<void> {
    await this.app.whileBusy("", async () => {
      // The server exports what is saved.
      await this.app.saver.settled();
      const link = h("a", { href: URL.createObjectURL(await api.exportFile(form)), download: form === "csv" ? "corners.csv" : "corners.mrk.json" });
      link.click();
      URL.revokeObjectURL(link.href);
    });
  }
}
