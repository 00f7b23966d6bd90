// The two ends of an object in a radiograph, by clicks or keys: near it in the whole picture, then exactly in an enlarged part.
import { h } from "../../shared/dom";
import { greysIn } from "../../shared/greys";
import * as api from "./api";
import { act } from "./page";
import { type Grey, paint } from "./picture";

type Point = [number, number];
interface Seen extends Grey { rows: number; columns: number; part: [number, number, number, number] }
const WIDE = 420, TALL = 560, PART = 160, SIDE = 480, CROSS = 7;
const STEPS: Record<string, Point> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const tenth = (value: number): number => Math.round(10 * value) / 10;

/** Both pictures; `done` gets the ends once there are two. */
export function ends(key: string, image: string, given: Point[], done: (ends: [Point, Point]) => void): HTMLElement {
  const keyed = { role: "application", tabindex: "0" };
  const whole = h("canvas", { class: "ends", "aria-label": "The radiograph", ...keyed }), near = h("canvas", { class: "ends near", "aria-label": "The part, enlarged", ...keyed });
  const said = h("p", { role: "status", class: "soft" }), crossed = h("p", { role: "status", class: "soft" }), found: Point[] = [...given];
  let all: Seen | null = null, part: Seen | null = null, next: 0 | 1 = 0;
  /** What keys move. */
  let cursor: Point | null = null;
  const say = (): void => {
    said.textContent = `${next ? "Second" : "First"} end: click near it in the radiograph, then exactly on it in the enlarged part. By keyboard arrows move a cross, with Shift farther and with Alt less far; Enter is the click.`;
    crossed.textContent = cursor ? `Cross at column ${cursor[0].toFixed(1)}, row ${cursor[1].toFixed(1)}.` : "";
  };
  const ask = async (wide: number, tall: number, box = ""): Promise<Seen> => greysIn<Seen>(await api.bare(key, image, wide, tall, box));
  const cross = (canvas: HTMLCanvasElement, seen: Seen): void => {
    const context = canvas.getContext("2d"), [left, top, right, bottom] = seen.part, across = canvas.width / (right - left), down = canvas.height / (bottom - top);
    if (!context) return;
    context.lineWidth = 2;
    [...found, ...(cursor ? [cursor] : [])].forEach(([column, row], i) => {
      const [x, y] = [(column + 0.5 - left) * across, (row + 0.5 - top) * down];
      context.strokeStyle = i < found.length ? "#ffcc00" : "#56b4e9";
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
  const look = ([column, row]: Point): void => act(async () => {
    if (!all) return;
    const { rows, columns } = all;
    part = null;  // until the new one is here: nobody clicks in the old one
    draw();
    const from = (at: number, most: number): number => Math.max(0, Math.min(Math.round(at - PART / 2), most - PART));
    const [left, top] = [from(column, columns), from(row, rows)], [right, bottom] = [Math.min(columns, left + PART), Math.min(rows, top + PART)];
    part = await ask(PART, PART, [left, top, right, bottom].join(","));
    draw();
    if (cursor) near.focus();
  });
  const set = ([column, row]: Point): void => {
    found[next] = [tenth(column), tenth(row)];
    next = next ? 0 : 1;
    say();
    draw();
    const [one, other] = found;
    if (one && other) done([one, other]);
    if (cursor) whole.focus();
  };
  const listen = (canvas: HTMLCanvasElement, seen: () => Seen | null, step: number, use: (at: Point) => void): void => {
    const to = (at: Point | null): void => { cursor = at; say(); draw(); };
    canvas.addEventListener("click", (event) => { const now = seen(); if (now) { const at = pixel(event, canvas, now); to(null); use(at); } });
    canvas.addEventListener("keydown", (event) => {
      const now = seen(), by = STEPS[event.key];
      if (!now || event.ctrlKey || event.metaKey || !(by || event.key === "Enter")) return;
      event.preventDefault();
      const [left, top, right, bottom] = now.part, size = step * (event.shiftKey ? 10 : event.altKey ? 0.1 : 1);
      const within = (at: number, low: number, high: number): number => Math.min(high - 1, Math.max(low, at));
      const from = cursor ?? [(left + right) / 2, (top + bottom) / 2], [across, down] = by ?? [0, 0];
      to([within(from[0] + size * across, left, right), within(from[1] + size * down, top, bottom)]);
      if (!by && cursor) use(cursor);
    });
  };
  listen(whole, () => all, 10, look);
  listen(near, () => part, 1, set);
  act(async () => { all = await ask(WIDE, TALL); draw(); say(); });
  return h("div", { class: "picked" }, said, crossed, h("div", { class: "row" }, whole, near));
}
