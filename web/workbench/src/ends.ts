// The two ends of an object in a radiograph, by clicks: near it in the whole picture, then exactly in an enlarged part.
import { h } from "../../shared/dom";
import { greysIn } from "../../shared/greys";
import * as api from "./api";
import { act } from "./page";
import { type Grey, paint } from "./picture";

type Point = [number, number];
interface Seen extends Grey { rows: number; columns: number; part: [number, number, number, number] }
const WIDE = 420, TALL = 560, PART = 160, SIDE = 480, CROSS = 7;
const tenth = (value: number): number => Math.round(10 * value) / 10;

/** Both pictures; `done` gets the ends once there are two. */
export function ends(key: string, image: string, given: Point[], done: (ends: [Point, Point]) => void): HTMLElement {
  const whole = h("canvas", { class: "ends", role: "img", "aria-label": "The radiograph" }), near = h("canvas", { class: "ends near", role: "img", "aria-label": "The part, enlarged" });
  const said = h("p", { role: "status", class: "soft" }), found: Point[] = [...given];
  let all: Seen | null = null, part: Seen | null = null, next: 0 | 1 = 0;
  const say = (): void => { said.textContent = `${next ? "Second" : "First"} end: click near it in the radiograph, then exactly on it in the enlarged part.`; };
  const ask = async (wide: number, tall: number, box = ""): Promise<Seen> => greysIn<Seen>(await api.bare(key, image, wide, tall, box));
  const cross = (canvas: HTMLCanvasElement, seen: Seen): void => {
    const context = canvas.getContext("2d"), [left, top, right] = seen.part, scale = canvas.width / (right - left);
    if (!context) return;
    context.lineWidth = 2;
    found.forEach(([column, row]) => {
      const [x, y] = [(column + 0.5 - left) * scale, (row + 0.5 - top) * scale];
      context.strokeStyle = "#ffcc00";
      context.beginPath();
      context.moveTo(x - CROSS, y); context.lineTo(x + CROSS, y); context.moveTo(x, y - CROSS); context.lineTo(x, y + CROSS);
      context.stroke();
    });
  };
  const draw = (): void => {
    if (all) { paint(whole, all, 1); cross(whole, all); }
    near.hidden = !part;
    if (part) { paint(near, part, SIDE / PART); cross(near, part); }
  };
  /** The pixel of the radiograph under a click; the first pixel's centre is (0, 0). */
  const pixel = (event: MouseEvent, canvas: HTMLCanvasElement, seen: Seen): Point => {
    const box = canvas.getBoundingClientRect(), [left, top, right, bottom] = seen.part;
    return [left + ((event.clientX - box.left) / box.width) * (right - left) - 0.5, top + ((event.clientY - box.top) / box.height) * (bottom - top) - 0.5];
  };
  whole.addEventListener("click", (event) => act(async () => {
    if (!all) return;
    const [column, row] = pixel(event, whole, all), { rows, columns } = all;
    const from = (at: number, most: number): number => Math.max(0, Math.min(Math.round(at - PART / 2), most - PART));
    const [left, top] = [from(column, columns), from(row, rows)], [right, bottom] = [Math.min(columns, left + PART), Math.min(rows, top + PART)];
    part = await ask(PART, PART, [left, top, right, bottom].join(","));
    draw();
  }));
  near.addEventListener("click", (event) => {
    if (!part) return;
    const [column, row] = pixel(event, near, part);
    found[next] = [tenth(column), tenth(row)];
    next = next ? 0 : 1;
    say();
    draw();
    const [one, other] = found;
    if (one && other) done([one, other]);
  });
  act(async () => { all = await ask(WIDE, TALL); draw(); say(); });
  return h("div", { class: "picked" }, said, h("div", { class: "row" }, whole, near));
}
