// Starts every viewer of the page, each when it first comes near the window. Nothing moves by itself.
import { VIEWS, type ViewName } from "./camera";
import { Panel } from "./panel";
import { readScene } from "./scene";
import { Stage } from "./stage";

/** On the viewer's element, for whoever automates the page. */
interface Handle {
  setForce(force: number): void;
  bone(name: string): { place: number[]; turn: number[] } | null;
  show(view: ViewName): void;
}

function need<T extends HTMLElement>(root: HTMLElement, role: string): T {
  const found = root.querySelector<T>(`[data-role="${role}"]`);
  if (!found) throw new Error(`the viewer has no part '${role}'`);
  return found;
}

function start(root: HTMLElement): void {
  const message = need(root, "message");
  const scene = readScene(need(root, "scene").textContent ?? "");
  const panel = new Panel(root, scene);
  need(root, "panel").hidden = false;
  const picture = (): void => {
    if (panel.stage) return;
    try {
      const stage = new Stage(scene, {
        root,
        canvas: need<HTMLCanvasElement>(root, "canvas"),
        labels: need(root, "labels"),
        sides: [need(root, "side-left"), need(root, "side-right")],
        caption: need(root, "caption"),
        buttons: [...root.querySelectorAll<HTMLElement>("button[data-view]")],
      });
      panel.connect(stage);
      stage.draw();
      message.hidden = true;
      root.dataset["state"] = "drawn";
    } catch (error) {
      // Most likely no WebGL; the slider and the numbers go on.
      message.textContent = `This browser can’t draw in 3D (${error instanceof Error ? error.message : "no WebGL"}). The numbers still follow the slider.`;
      root.dataset["state"] = "no picture";
    }
  };
  const handle: Handle = {
    setForce: (force) => panel.setForce(force),
    bone: (name) => panel.bone(name),
    show: (view) => {
      if (VIEWS.includes(view)) panel.stage?.camera.show(view);
    },
  };
  Object.assign(root, { viewer: handle });
  message.textContent = "Drawing …";
  const table = root.querySelector<HTMLDetailsElement>("details");
  const open = table?.open ?? false;
  addEventListener("beforeprint", () => {
    picture();
    panel.stage?.draw();
    if (table) table.open = true;
  });
  addEventListener("afterprint", () => {
    if (table) table.open = open;
  });
  new IntersectionObserver(
    (entries, observer) => {
      if (!entries.some((entry) => entry.isIntersecting)) return;
      observer.disconnect();
      picture();
    },
    { rootMargin: "300px" },
  ).observe(root);
}

for (const root of document.querySelectorAll<HTMLElement>("[data-viewer]")) start(root);
