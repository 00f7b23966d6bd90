// Small pictures of radiographs: grey values as the server sends them, on a canvas, asked for when they come into sight.
import { h } from "../../shared/dom";
import { greysIn } from "../../shared/greys";

export interface Grey { levels: Uint16Array; shown: [number, number]; window: [number, number]; shape: [number, number] }
const SIDE_BY_SIDE = 2, MOST_KEPT = 500;
const kept = new Map<string, Promise<Grey>>(), waiting: (() => Promise<void>)[] = [];
// `taken`: how often radiographs were taken away; pictures from before are asked for no more.
let running = 0, held = 0, taken = 0;

function turn(): void {
  if (running >= SIDE_BY_SIDE || held) return;
  const next = waiting.shift();
  if (!next) return;
  running++;
  void next().finally(() => { running--; turn(); });
}

/** Do what takes the radiographs away, while no picture of them is being asked for, and ask for none afterwards. */
export async function last<T>(what: () => Promise<T>): Promise<T> {
  held++;
  try {
    while (running) await new Promise((wait) => setTimeout(wait, 20));
    const done = await what();
    taken++;
    return done;
  } finally {
    held--;
    for (let i = 0; i < SIDE_BY_SIDE; i++) turn();
  }
}

/** Grey values on a canvas of their size, each `times` as large, in the shape that pixels have. */
export function paint(canvas: HTMLCanvasElement, { levels, shown: [wide, tall], window: [low, high], shape: [across, down] }: Grey, times = 1): void {
  const context = canvas.getContext("2d"), small = new OffscreenCanvas(wide, tall);
  if (!context) return;
  const picture = context.createImageData(wide, tall);
  levels.forEach((level, i) => {
    picture.data.fill(Math.round((255 * (level - low)) / Math.max(1, high - low)), 4 * i, 4 * i + 3);
    picture.data[4 * i + 3] = 255;
  });
  small.getContext("2d")?.putImageData(picture, 0, 0);
  canvas.width = Math.round(times * across * wide);
  canvas.height = Math.round(times * down * tall);
  context.imageSmoothingEnabled = times === 1;
  context.drawImage(small, 0, 0, canvas.width, canvas.height);
}

/** The picture of what `source` gives; `key` is the same for the same picture. */
export function thumbnail(key: string, source: () => Promise<Response>, alt: string): HTMLElement {
  const canvas = h("canvas", { class: "thumb", role: "img", "aria-label": alt, width: 60, height: 80 }), made = taken;
  const show = async (): Promise<void> => {
    if (!canvas.isConnected || made < taken) return;
    const asked = kept.get(key) ?? source().then((answer) => greysIn<Grey>(answer));
    kept.set(key, asked);
    for (const old of kept.keys()) if (kept.size > MOST_KEPT) kept.delete(old);
    try {
      paint(canvas, await asked);
      canvas.dataset["state"] = "shown";
    } catch {
      kept.delete(key);
      canvas.dataset["state"] = "failed";
      canvas.setAttribute("aria-label", `${alt}: no picture`);
    }
  };
  const sight = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    sight.disconnect();
    waiting.push(show);
    turn();
  }, { rootMargin: "400px" });
  sight.observe(canvas);
  return canvas;
}
