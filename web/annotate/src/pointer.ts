// Mouse, pen and finger on the radiograph.
import type { App } from "./app";
import { changed, moved, type Point, type Selection } from "./marks";

type Drag = { what: "mark"; at: Selection; last: Point } | { what: "pan"; last: Point } | { what: "grey"; last: Point };

export function listen(app: App): void {
  const { canvas } = app.stage;
  let drag: Drag | null = null;
  const place = (event: MouseEvent): Point => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };

  canvas.addEventListener("pointerdown", (event) => {
    canvas.focus();
    canvas.setPointerCapture(event.pointerId);
    const at = place(event), under = app.stage.under(at);
    app.cursor = null;
    if (event.button === 2) drag = { what: "grey", last: at };
    else if (event.button === 1) drag = { what: "pan", last: at };
    else if (app.tool !== "move" && !(under && under.kind === app.tool)) { app.add(app.stage.toPixel(at)); drag = null; }
    else if (under) { app.select(under); drag = { what: "mark", at: under, last: app.stage.toPixel(at) }; }
    else { app.select(null); drag = { what: "pan", last: at }; }
    event.preventDefault();
  });

  canvas.addEventListener("pointermove", (event) => {
    const at = place(event);
    if (!drag) {
      canvas.dataset["over"] = app.stage.under(at) ? "mark" : "";
      return;
    }
    if (drag.what === "mark") {
      const pixel = app.stage.toPixel(at), by: Point = [pixel[0] - drag.last[0], pixel[1] - drag.last[1]];
      const { at: which } = drag;
      drag.last = pixel;
      app.preview((marks) => changed(marks, which, (p) => moved(p, by)));
    } else {
      const by: Point = [at[0] - drag.last[0], at[1] - drag.last[1]];
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

  const end = (): void => {
    if (drag?.what === "mark") app.settle(`${app.spoken(drag.at)} dragged`);
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
