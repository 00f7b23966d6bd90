// Mouse, pen and finger on the radiograph.
import type { App } from "./app";
import { centre, changed, moved, type Point, type Selection } from "./marks";

type Drag =
  | { what: "mark"; at: Selection; last: Point }
  | { what: "pan" | "grey" | "tap"; last: Point };

// A finger that moves less than this, or a mouse that does, means the place and no drag.
const STILL = 10;

export function listen(app: App): void {
  const { canvas } = app.stage;
  let drag: Drag | null = null;
  const fingers = new Map<number, Point>();
  const place = (event: MouseEvent): Point => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const spread = (): [Point, number] => {
    const [a, b] = [...fingers.values()] as [Point, Point];
    return [centre([a, b]), Math.max(1, Math.hypot(b[0] - a[0], b[1] - a[1]))];
  };

  canvas.addEventListener("pointerdown", (event) => {
    canvas.focus();
    canvas.setPointerCapture(event.pointerId);
    event.preventDefault();
    const at = place(event), finger = event.pointerType === "touch";
    if (finger) fingers.set(event.pointerId, at);
    if (fingers.size > 1) {
      // Two fingers mean the picture, whatever the first had begun.
      if (drag?.what === "mark") app.cancel();
      drag = null;
      return;
    }
    const under = app.stage.under(at, finger);
    app.cursor = null;
    if (event.button === 2) drag = { what: "grey", last: at };
    else if (event.button === 1) drag = { what: "pan", last: at };
    else if (app.tool !== "move" && !(under && under.kind === app.tool)) drag = { what: "tap", last: at };
    else if (under) { app.select(under); drag = { what: "mark", at: under, last: app.stage.toPixel(at) }; }
    else { app.select(null); drag = { what: "pan", last: at }; }
  });

  canvas.addEventListener("pointermove", (event) => {
    const at = place(event);
    if (fingers.has(event.pointerId)) {
      const before = fingers.size > 1 ? spread() : null;
      fingers.set(event.pointerId, at);
      if (before) {
        const [middle, apart] = spread();
        app.stage.pan([middle[0] - before[0][0], middle[1] - before[0][1]]);
        return app.stage.zoom(apart / before[1], middle);
      }
    }
    if (!drag) {
      canvas.dataset["over"] = app.stage.under(at) ? "mark" : "";
    } else if (drag.what === "mark") {
      const pixel = app.stage.toPixel(at), by: Point = [pixel[0] - drag.last[0], pixel[1] - drag.last[1]];
      const { at: which } = drag;
      drag.last = pixel;
      app.preview((marks) => changed(marks, which, (p) => moved(p, by)));
    } else {
      const by: Point = [at[0] - drag.last[0], at[1] - drag.last[1]];
      if (drag.what === "tap") {
        if (Math.hypot(...by) < STILL) return;
        drag.what = "pan";
      }
      drag.last = at;
      if (drag.what === "pan") app.stage.pan(by);
      else {
        const [low, high] = app.stage.window, size = high - low;
        const middle = 0.5 * (low + high) - by[1] * size * 0.004, next = Math.max(200, size * (1 + 0.005 * by[0]));
        app.stage.setWindow([middle - 0.5 * next, middle + 0.5 * next]);
        app.says.refresh();
      }
    }
  });

  const end = (event: PointerEvent): void => {
    fingers.delete(event.pointerId);
    if (drag?.what === "mark") app.settle(`${app.spoken(drag.at)} dragged`);
    else if (drag?.what === "tap" && event.type === "pointerup") app.add(app.stage.toPixel(drag.last));
    drag = null;
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    app.stage.zoom(Math.exp(-0.0015 * event.deltaY), place(event));
  }, { passive: false });
}
