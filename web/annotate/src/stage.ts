// The radiograph on a canvas with what is marked on it: zoom, greys, drawing, and what lies under a place.
import { h } from "../../shared/dom";
import type { Cobb, Grey, TrackedFrame } from "./api";
import { centre, type ImageMarks, type Point, type Quad, type Selection, selected } from "./marks";

// Blue, orange, yellow and white of the Okabe-Ito set; shape and width tell the same as colour does.
const MARK = "#56b4e9", CHOSEN = "#ffb000", ANGLE = "#f0e442", TRACKED = "#ffffff", HALO = "rgba(0,0,0,.75)";
// A finger covers more than a mouse points at. Of a small vertebra corners take less, so that its middle stays free.
const HANDLE = 4.5, REACH = 11, FINGER = 24, OF_A_SIDE = 0.4, LOUPE = 150, LOUPE_ZOOM = 4, RING = 10, MOST_PATCHES = 4;

export interface Shown {
  marks: ImageMarks; selection: Selection | null; names: readonly string[]; cobb: Cobb | null; tracked: TrackedFrame | null;
  cursor: Point | null; show: boolean; spine: boolean; lowest: number; unseen: readonly string[];
  /** Of a vertebra's pedicles, 0 left and 1 right, the one that is only guessed. */
  guessed: Record<string, number>;
}
interface Wanted { part: [number, number, number, number]; most: Point }
interface Patch { grey: Grey; picture: HTMLCanvasElement }

export class Stage {
  private readonly context: CanvasRenderingContext2D;
  private readonly picture = h("canvas");
  private grey: Grey | null = null;
  private patches: Patch[] = [];
  /** Called when something else of the radiograph may be in sight. */
  onview: () => void = () => undefined;
  private shown: Shown | null = null;
  private due = false;
  /** Screen pixels the shorter side of a radiograph's pixel, and where its (0, 0) lies on the canvas. */
  scale = 1;
  private origin: Point = [0, 0];
  private fitted = true;
  /** Darkest and brightest grey shown, 0..65535. */
  window: [number, number] = [0, 65535];

  constructor(readonly canvas: HTMLCanvasElement) {
    const context = canvas.getContext("2d");
    if (!context) throw new Error("this browser can’t draw on a canvas");
    this.context = context;
    new ResizeObserver(() => this.resize()).observe(canvas);
  }

  load(grey: Grey, keepView: boolean): void {
    const before = this.grey;
    const same = keepView && before?.rows === grey.rows && before.columns === grey.columns && String(before.shape) === String(grey.shape);
    this.grey = grey;
    this.patches = [];
    if (!same) { this.window = [...grey.window]; this.resize(); this.fit(); }
    this.develop();
  }

  /** No radiograph is in sight, as long as the one that is wanted is not there. */
  clear(): void {
    this.grey = null;
    this.patches = [];
    this.redraw();
  }

  /** The window that the radiograph opens with. */
  get natural(): [number, number] { return this.grey?.window ?? [0, 65535]; }
  get size(): Point { return this.grey ? [this.grey.columns, this.grey.rows] : [1, 1]; }
  /** A pixel's width and height over the shorter of both. */
  get shape(): Point { return this.grey?.shape ?? [1, 1]; }
  get first(): Point { return this.grey?.first ?? [1, 0]; }

  setWindow(window: [number, number]): void {
    this.window = window;
    this.develop();
  }

  /** What of the radiograph the screen shows finer than it was sent: what is in sight, and what lies under the loupe. */
  wanted(point: Point | undefined): Wanted[] {
    const grey = this.grey;
    if (!grey || grey.shown[0] >= grey.columns) return [];
    // As fine as the longer side of a pixel is shown.
    const { clientWidth, clientHeight } = this.canvas, { shape } = this, fine = Math.max(...shape) * this.ratio;
    const ask = (from: Point, to: Point, per: number): Wanted[] => {
      const part: Wanted["part"] = [Math.max(0, Math.floor(from[0])), Math.max(0, Math.floor(from[1])), Math.min(grey.columns, Math.ceil(to[0])), Math.min(grey.rows, Math.ceil(to[1]))];
      const [wide, high] = [part[2] - part[0], part[3] - part[1]], enough = 0.9 * Math.min(1, per);
      if (wide < 2 || high < 2 || enough <= grey.shown[0] / grey.columns) return [];
      const there = this.patches.some(({ grey: { part: p, shown } }) => p[0] <= part[0] && p[1] <= part[1] && p[2] >= part[2] && p[3] >= part[3] && shown[0] / (p[2] - p[0]) >= enough);
      return there ? [] : [{ part, most: [sent(wide, per), sent(high, per)] }];
    };
    const sent = (size: number, per: number): number => Math.min(8192, Math.max(16, Math.ceil(size * Math.min(1, per))));
    const [near, far] = shape.map((side) => LOUPE / LOUPE_ZOOM / side) as Point;
    return [
      ...ask(this.toPixel([0, 0]), this.toPixel([clientWidth, clientHeight]), this.scale * fine),
      ...(point ? ask([point[0] - near, point[1] - far], [point[0] + near, point[1] + far], LOUPE_ZOOM * fine) : []),
    ];
  }

  /** A finer part of the radiograph in sight. */
  patch(grey: Grey): void {
    const made: Patch = { grey, picture: h("canvas") };
    this.patches = [...this.patches.slice(1 - MOST_PATCHES), made];
    this.print(made);
    this.redraw();
  }

  private develop(): void {
    if (!this.grey) return;
    this.print({ grey: this.grey, picture: this.picture });
    for (const patch of this.patches) this.print(patch);
    this.redraw();
  }

  private print({ grey, picture }: Patch): void {
    const [wide, tall] = grey.shown, context = picture.getContext("2d");
    if (!context) return;
    if (picture.width !== wide || picture.height !== tall) { picture.width = wide; picture.height = tall; }
    const [low, high] = this.window, table = new Uint32Array(65536);
    for (let i = 0; i < 65536; i++) {
      const shade = Math.min(255, Math.max(0, Math.round(((i - low) * 255) / Math.max(1, high - low))));
      table[i] = 0xff000000 | (shade << 16) | (shade << 8) | shade;
    }
    const image = context.createImageData(wide, tall), pixels = new Uint32Array(image.data.buffer);
    for (let i = 0; i < pixels.length; i++) pixels[i] = table[grey.levels[i] as number] as number;
    context.putImageData(image, 0, 0);
  }

  /** The radiograph about a place (x, y), its finer parts over the whole. */
  private expose(): void {
    const c = this.context, draw = (picture: HTMLCanvasElement, [left, top, right, bottom]: Grey["part"]): void => {
      // The first pixel's centre is (0, 0), so a picture begins half a pixel before.
      const [x, y] = this.toPlace([left - 0.5, top - 0.5]), [across, down] = this.scales;
      c.drawImage(picture, x, y, (right - left) * across, (bottom - top) * down);
    };
    if (this.grey) draw(this.picture, this.grey.part);
    for (const { picture, grey } of this.patches) draw(picture, grey.part);
  }

  private get ratio(): number { return window.devicePixelRatio || 1; }

  private resize(): void {
    if (this.fitted) this.fit(); else this.redraw();
  }

  fit(): void {
    const [columns, rows] = this.size, { shape } = this, { clientWidth, clientHeight } = this.canvas;
    this.scale = Math.max(0.01, Math.min(clientWidth / (columns * shape[0]), clientHeight / (rows * shape[1])));
    this.centre([0.5 * (columns - 1), 0.5 * (rows - 1)]);
    this.fitted = true;
    this.redraw();
  }

  zoom(factor: number, at?: Point): void {
    const place: Point = at ?? [0.5 * this.canvas.clientWidth, 0.5 * this.canvas.clientHeight];
    const pixel = this.toPixel(place);
    this.scale = Math.min(40, Math.max(0.02, this.scale * factor));
    this.centre(pixel, place);
    this.fitted = false;
    this.redraw();
  }

  /** A pixel at a place of the canvas, or in its middle. */
  private centre(pixel: Point, place: Point = [0.5 * this.canvas.clientWidth, 0.5 * this.canvas.clientHeight]): void {
    const [across, down] = this.scales;
    this.origin = [place[0] - pixel[0] * across, place[1] - pixel[1] * down];
  }

  /** The picture about a vertebra, so large that its surroundings can be told. */
  show(quad: Quad): void {
    const { shape } = this, xs = quad.map((p) => p[0] * shape[0]), ys = quad.map((p) => p[1] * shape[1]), { clientWidth, clientHeight } = this.canvas;
    const size = Math.max(Math.max(...xs) - Math.min(...xs), Math.max(...ys) - Math.min(...ys), 4);
    const scale = Math.min(40, (0.4 * Math.min(clientWidth, clientHeight)) / size);
    // What was chosen by hand stays, where it is about that.
    if (this.scale < 0.6 * scale || this.scale > 1.8 * scale) this.scale = scale;
    this.centre(centre(quad));
    this.fitted = false;
    this.redraw();
  }

  pan(by: Point): void {
    this.origin = [this.origin[0] + by[0], this.origin[1] + by[1]];
    this.fitted = false;
    this.redraw();
  }

  /** Move the picture only as far as a pixel needs to be seen. */
  reveal(pixel: Point): void {
    const place = this.toPlace(pixel), margin = 40;
    const need = (x: number, size: number): number => (x < margin ? margin - x : x > size - margin ? size - margin - x : 0);
    const by: Point = [need(place[0], this.canvas.clientWidth), need(place[1], this.canvas.clientHeight)];
    if (!this.fitted && (by[0] || by[1])) this.pan(by);
  }

  /** Screen pixels a radiograph's pixel, along and down. */
  private get scales(): Point { return [this.scale * this.shape[0], this.scale * this.shape[1]]; }
  toPixel(place: Point): Point { const [across, down] = this.scales; return [(place[0] - this.origin[0]) / across, (place[1] - this.origin[1]) / down]; }
  toPlace(pixel: Point): Point { const [across, down] = this.scales; return [pixel[0] * across + this.origin[0], pixel[1] * down + this.origin[1]]; }

  /** The mark under a place of the canvas: points before corners before whole vertebrae, the nearest of a kind. */
  under(place: Point, finger = false): Selection | null {
    const shown = this.shown;
    if (!this.grey || !shown?.show) return null;
    const found: [number, Selection][] = [];
    const offer = (points: readonly Point[] | undefined, make: (i: number) => Selection): void =>
      points?.forEach((p, i) => {
        const q = this.toPlace(p), distance = Math.hypot(q[0] - place[0], q[1] - place[1]);
        if (distance < reach) found.push([distance, make(i)]);
      });
    let reach = finger ? FINGER : REACH;
    const marks = shown.marks;
    if (shown.spine) offer(marks.spine, (part) => ({ kind: "spine", name: "", part }));
    for (const kind of ["pelvis", "shoulder"] as const) offer(marks.supports[kind], (part) => ({ kind, name: "", part }));
    for (const [name, pair] of Object.entries(marks.pedicles)) offer(pair, (part) => ({ kind: "pedicle", name, part }));
    for (const [name, quad] of Object.entries(this.quads())) {
      const places = quad.map((p) => this.toPlace(p));
      const side = Math.min(...places.map((p, i) => { const q = places[(i + 1) % 4] as Point; return Math.hypot(q[0] - p[0], q[1] - p[1]); }));
      // Outwards the whole reach, inwards so much that a vertebra's middle can be got hold of.
      reach = within(this.toPixel(place), quad) ? Math.min(finger ? FINGER : REACH, OF_A_SIDE * side) : finger ? FINGER : REACH;
      offer(quad, (part) => ({ kind: "vertebra", name, part }));
    }
    if (found.length) return found.reduce((a, b) => (b[0] < a[0] - 1e-9 ? b : a))[1];
    const pixel = this.toPixel(place);
    const name = Object.entries(this.quads()).find(([, quad]) => within(pixel, quad))?.[0];
    return name === undefined ? null : { kind: "vertebra", name, part: -1 };
  }

  /** Marked vertebrae, and those that were tracked where they are not marked. */
  private quads(): Record<string, Quad> {
    return { ...this.shown?.tracked?.vertebrae, ...this.shown?.marks.vertebrae };
  }

  draw(shown: Shown): void {
    this.shown = shown;
    this.redraw();
  }

  private redraw(): void {
    if (this.due) return;
    this.due = true;
    requestAnimationFrame(() => { this.due = false; this.paint(); });
  }

  private paint(): void {
    const c = this.context, { ratio } = this, { clientWidth, clientHeight } = this.canvas;
    // Each time: on another screen its pixels are others, though the canvas is as large as before.
    const wide = Math.max(1, Math.round(clientWidth * ratio)), high = Math.max(1, Math.round(clientHeight * ratio));
    if (this.canvas.width !== wide || this.canvas.height !== high) { this.canvas.width = wide; this.canvas.height = high; }
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.fillStyle = "#000";
    c.fillRect(0, 0, clientWidth, clientHeight);
    if (!this.grey) return;
    c.imageSmoothingEnabled = this.scale < 4;
    // What was sent fits the screen; only a picture that is shown smaller than that needs more than two pixels' mean.
    c.imageSmoothingQuality = this.grey.shown[0] > 1.5 * this.grey.columns * this.scale * ratio ? "high" : "low";
    this.expose();
    this.onview();
    const shown = this.shown;
    if (shown?.show) { this.paintMarks(shown); this.paintLoupe(shown); }
    this.paintSides();
  }

  private paintSides(): void {
    const c = this.context, lateral = this.grey?.kind === "lateral", right = (this.first[0] ?? 1) > 0;
    const names = lateral ? ["A", "P"] : ["L", "R"];
    c.font = "600 18px system-ui, sans-serif";
    c.textBaseline = "top";
    this.text(names[right ? 1 : 0] as string, 10, 10, "#fff", "left");
    this.text(names[right ? 0 : 1] as string, this.canvas.clientWidth - 10, 10, "#fff", "right");
  }

  private text(words: string, x: number, y: number, colour: string, align: CanvasTextAlign): void {
    const c = this.context;
    c.textAlign = align;
    c.lineWidth = 3.5;
    c.lineJoin = "round";
    c.strokeStyle = HALO;
    c.strokeText(words, x, y);
    c.fillStyle = colour;
    c.fillText(words, x, y);
  }

  private outline(points: readonly Point[], colour: string, width: number, dash: number[], closed: boolean): void {
    const c = this.context;
    c.beginPath();
    points.forEach((p, i) => { const q = this.toPlace(p); if (i) c.lineTo(...q); else c.moveTo(...q); });
    if (closed) c.closePath();
    c.setLineDash([]);
    c.strokeStyle = HALO;
    c.lineWidth = width + 1.6;
    c.stroke();
    c.setLineDash(dash);
    c.strokeStyle = colour;
    c.lineWidth = width;
    c.stroke();
    c.setLineDash([]);
  }

  private paintMarks(shown: Shown): void {
    const c = this.context, { marks, selection } = shown;
    c.font = "600 13px system-ui, sans-serif";
    c.textBaseline = "middle";
    for (const [name, quad] of Object.entries(this.quads())) {
      const chosen = selection?.kind === "vertebra" && selection.name === name, measured = name in marks.vertebrae;
      const unseen = shown.unseen.includes(name);
      this.outline(quad, chosen ? CHOSEN : measured ? MARK : TRACKED, chosen ? 2.4 : 1.4, unseen ? [2, 4] : measured ? [] : [6, 4], true);
      const side = Math.max(...quad.map((p) => this.toPlace(p)[0]));
      this.text(name, side + 9, this.toPlace(centre(quad))[1], chosen ? CHOSEN : "#fff", "left");
      if (!measured) this.paintLost(quad, shown.tracked?.quality[name]);
      if (chosen) quad.forEach((p, i) => this.handle(p, i === selection.part));
    }
    if (shown.cobb) this.paintAngle(this.quads(), shown.cobb);
    if (shown.spine) marks.spine.forEach((p, i) => this.point(p, String(i + 1), "circle", this.isChosen("spine", "", i)));
    for (const kind of ["pelvis", "shoulder"] as const)
      marks.supports[kind]?.forEach((p, i) => this.point(p, kind, kind === "pelvis" ? "triangle" : "diamond", this.isChosen(kind, "", i)));
    for (const [name, pair] of Object.entries(marks.pedicles))
      pair.forEach((p, i) => this.point(p, "", "cross", this.isChosen("pedicle", name, i), shown.guessed[name] === i));
    if (shown.cursor) this.crosshair(shown.cursor);
  }

  private isChosen(kind: string, name: string, part: number): boolean {
    const at = this.shown?.selection;
    return at?.kind === kind && at.name === name && at.part === part;
  }

  private handle(p: Point, chosen: boolean): void {
    const c = this.context, [x, y] = this.toPlace(p), size = chosen ? HANDLE + 3 : HANDLE;
    // Hollow: what it marks stays in sight.
    for (const [colour, width] of [[HALO, chosen ? 5 : 3.4], [CHOSEN, chosen ? 2.6 : 1.6]] as const) {
      c.strokeStyle = colour;
      c.lineWidth = width;
      c.strokeRect(x - size, y - size, 2 * size, 2 * size);
    }
  }

  /** Around a doubtful corner a ring, around a lost one a broken one; the sign stands outside, the corner stays in sight. */
  private paintLost(quad: Quad, quality: readonly number[] | undefined): void {
    const c = this.context, middle = this.toPlace(centre(quad));
    quad.forEach((p, i) => {
      const q = quality?.[i] ?? 1;
      if (q >= (this.shown?.lowest ?? 0)) return;
      const [x, y] = this.toPlace(p), away = Math.hypot(x - middle[0], y - middle[1]) || 1;
      const [dx, dy] = [(x - middle[0]) / away, (y - middle[1]) / away];
      c.setLineDash(q > 0 ? [] : [4, 5]);
      for (const [colour, width] of [[HALO, 4], [CHOSEN, 2]] as const) {
        c.beginPath();
        c.arc(x, y, RING, 0, 2 * Math.PI);
        c.strokeStyle = colour;
        c.lineWidth = width;
        c.stroke();
      }
      c.setLineDash([]);
      this.text(q > 0 ? "?" : "×", x + 2 * RING * dx, y + 2 * RING * dy, CHOSEN, "center");
    });
  }

  private point(p: Point, words: string, shape: "circle" | "triangle" | "diamond" | "cross", chosen: boolean, guessed = false): void {
    const c = this.context, [x, y] = this.toPlace(p), r = chosen ? 7.5 : 5.5;
    c.beginPath();
    if (shape === "circle") c.arc(x, y, r, 0, 2 * Math.PI);
    else if (shape === "cross") { c.moveTo(x - r, y); c.lineTo(x + r, y); c.moveTo(x, y - r); c.lineTo(x, y + r); }
    else {
      const corners: Point[] = shape === "triangle" ? [[0, -r], [r, r], [-r, r]] : [[0, -r], [r, 0], [0, r], [-r, 0]];
      corners.forEach(([dx, dy], i) => (i ? c.lineTo(x + dx, y + dy) : c.moveTo(x + dx, y + dy)));
      c.closePath();
    }
    c.strokeStyle = HALO; c.lineWidth = 4.5; c.stroke();
    c.setLineDash(guessed ? [2, 2.5] : []);
    c.strokeStyle = chosen ? CHOSEN : MARK; c.lineWidth = 2; c.stroke();
    c.setLineDash([]);
    if (words) this.text(words, x + r + 4, y, chosen ? CHOSEN : "#fff", "left");
  }

  /** The two endplates between which the angle is read, drawn on to where a reader looks for them. */
  private paintAngle(quads: Record<string, Quad>, cobb: Cobb): void {
    const upper = quads[cobb.upper], lower = quads[cobb.lower];
    if (!upper || !lower) return;
    const beyond = ([a, b]: [Point, Point]): [Point, Point] => {
      const by: Point = [0.9 * (b[0] - a[0]), 0.9 * (b[1] - a[1])];
      return [[a[0] - by[0], a[1] - by[1]], [b[0] + by[0], b[1] + by[1]]];
    };
    this.outline(beyond([upper[0], upper[1]]), ANGLE, 1.6, [9, 5], false);
    this.outline(beyond([lower[3], lower[2]]), ANGLE, 1.6, [9, 5], false);
  }

  private crosshair(p: Point): void {
    const [x, y] = this.toPlace(p), far = 24;
    this.context.lineCap = "butt";
    for (const [a, b] of [[[x - far, y], [x - 5, y]], [[x + 5, y], [x + far, y]], [[x, y - far], [x, y - 5]], [[x, y + 5], [x, y + far]]] as [Point, Point][])
      this.outline([this.toPixel(a), this.toPixel(b)], CHOSEN, 2, [], false);
  }

  /** What is selected, larger, in a corner of the canvas away from it. */
  private paintLoupe(shown: Shown): void {
    const at = shown.selection;
    if (!at || (at.kind === "vertebra" && at.part < 0) || this.scale > LOUPE_ZOOM) return;
    const quads = this.quads(), [p] = selected({ ...shown.marks, vertebrae: quads }, at);
    if (!p) return;
    const c = this.context, [px, py] = this.toPlace(p);
    const left = px < LOUPE + 60 && py > this.canvas.clientHeight - LOUPE - 60 ? this.canvas.clientWidth - LOUPE - 10 : 10;
    const top = this.canvas.clientHeight - LOUPE - 10, { scale, origin } = this;
    c.save();
    c.beginPath(); c.rect(left, top, LOUPE, LOUPE); c.clip();
    c.fillStyle = "#000"; c.fillRect(left, top, LOUPE, LOUPE);
    this.scale = LOUPE_ZOOM;
    this.centre(p, [left + LOUPE / 2, top + LOUPE / 2]);
    this.expose();
    for (const quad of Object.values(quads)) this.outline(quad, MARK, 1, [], true);
    this.crosshair(p);
    this.scale = scale;
    this.origin = origin;
    c.restore();
    c.strokeStyle = "#fff"; c.lineWidth = 1; c.strokeRect(left + 0.5, top + 0.5, LOUPE - 1, LOUPE - 1);
  }
}

function within(p: Point, quad: Quad): boolean {
  const sides = quad.map((a, i) => {
    const b = quad[(i + 1) % 4] as Point;
    return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]);
  });
  return sides.every((s) => s >= 0) || sides.every((s) => s <= 0);
}
