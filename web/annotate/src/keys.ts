// Everything by keyboard. Letters count on the radiograph alone, so that they disturb no other control.
import type { App } from "./app";
import { centre, type Point, selected } from "./marks";

export const KEYS: [string, string][] = [
  ["Page Up / Page Down", "vertebra above, below"],
  ["1 2 3 4, 0", "a corner, the whole vertebra"],
  ["5 6", "its left, its right pedicle"],
  ["Arrows", "move by 1 pixel; with Shift 10, with Alt 0.1"],
  ["Q / E", "turn the vertebra by half a degree"],
  ["Delete", "not visible; removes a point"],
  ["P", "points along the spine: arrows move the cross, Enter sets a point"],
  ["S / H / D", "pelvis, shoulder, pedicle points, in the same way"],
  ["L", "next vertebra to look at, large"],
  ["Escape", "back to moving"],
  ["O", "propose vertebrae"],
  ["Ctrl+Z / Ctrl+Y", "undo, redo"],
  ["+ / −, F", "zoom, whole radiograph"],
  ["Ctrl+Arrows", "move the picture"],
  ["[ / ]", "frame before, next frame"],
  ["Mouse", "drag corners and vertebrae; wheel zooms; drag beside marks moves the picture; right button drags greys"],
  ["Touch", "one finger as the mouse; two fingers zoom and move the picture"],
];
const STEPS: Record<string, Point> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export function listen(app: App): void {
  addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.altKey) return;
    const key = event.key.toLowerCase();
    if (key === "z" && !event.shiftKey) app.undo();
    else if (key === "y" || (key === "z" && event.shiftKey)) app.redo();
    else return;
    event.preventDefault();
  });
  app.stage.canvas.addEventListener("keydown", (event) => {
    if (acted(app, event)) event.preventDefault();
  });
}

function acted(app: App, event: KeyboardEvent): boolean {
  const step = STEPS[event.key];
  if (step) {
    const size = event.shiftKey ? 10 : event.altKey ? 0.1 : 1, by: Point = [size * step[0], size * step[1]];
    if (event.ctrlKey || event.metaKey) app.stage.pan([-60 * step[0], -60 * step[1]]);
    else if (app.tool !== "move") cross(app, by);
    else app.nudge(by);
    return true;
  }
  if (event.ctrlKey || event.metaKey || event.altKey) return false;
  switch (event.key.toLowerCase()) {
    case "pagedown": case "n": app.step(1); break;
    case "pageup": case "b": app.step(-1); break;
    case "home": app.step(-99); break;
    case "end": app.step(99); break;
    case "0": app.part(-1); break;
    case "1": case "2": case "3": case "4": app.part(Number(event.key) - 1); break;
    case "5": case "6": app.pedicle(Number(event.key) - 5); break;
    case "q": app.turnBy(-0.5); break;
    case "e": app.turnBy(0.5); break;
    case "delete": case "backspace": app.remove(); break;
    case "p": tool(app, "spine"); break;
    case "s": tool(app, "pelvis"); break;
    case "h": tool(app, "shoulder"); break;
    case "d": tool(app, "pedicle"); break;
    case "escape": app.choose("move"); app.select(null); break;
    case "enter": if (app.tool === "move" || !app.cursor) return false; app.add(app.cursor); break;
    case "o": void app.propose(); break;
    case "l": app.lookOn(); break;
    case "+": case "=": app.stage.zoom(1.25, place(app)); break;
    case "-": app.stage.zoom(0.8, place(app)); break;
    case "f": app.stage.fit(); break;
    case "[": void app.open(app.image.name, app.frame - 1); break;
    case "]": void app.open(app.image.name, app.frame + 1); break;
    default: return false;
  }
  return true;
}

function tool(app: App, name: "spine" | "pelvis" | "shoulder" | "pedicle"): void {
  if (!app.tools.includes(name)) return app.says.aloud("there is no such point in this radiograph");
  app.choose(name);
  cross(app, [0, 0]);
}

/** The cross that places points by keyboard, at first where something is chosen; ten times as fast as what nudges marks. */
function cross(app: App, by: Point): void {
  const { stage } = app, [columns, rows] = stage.size;
  const at = app.selection, points = at ? selected(app.seen, at) : [];
  const from = app.cursor ?? (points.length ? centre(points) : stage.toPixel([0.5 * stage.canvas.clientWidth, 0.5 * stage.canvas.clientHeight]));
  const held = (x: number, size: number): number => Math.min(size - 1, Math.max(0, x));
  app.cursor = [held(from[0] + 10 * by[0], columns), held(from[1] + 10 * by[1], rows)];
  stage.reveal(app.cursor);
  app.says.aloud(`cross at column ${app.cursor[0].toFixed(0)}, row ${app.cursor[1].toFixed(0)}`);
  app.after();
}

function place(app: App): Point | undefined {
  const at = app.selection, quad = at?.kind === "vertebra" ? app.marks.vertebrae[at.name] : undefined;
  const p = quad?.[Math.max(0, at?.part ?? 0)] ?? app.cursor;
  return p ? app.stage.toPlace(p) : undefined;
}
