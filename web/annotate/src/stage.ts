// The radiograph on a canvas with what is marked on it: zoom, greys, drawing, and what lies under a place.
import type { Cobb, Grey, TrackedFrame } from "./api";
import { centre, type ImageMarks, type Point, type Quad, type Selection, selected } from "./marks";

// Blue, orange, yellow and white of the Okabe-Ito set; shape and width tell the same as colour does.
const MARK = "#56b4e9", CHOSEN = "#ffb000", ANGLE = "#f0e442", TRACKED = "#ffffff", HALO = "rgba(0,0,0,.75)";
const HANDLE = 4.5, REACH = 11, LOUPE = 150, LOUPE_ZOOM = 4;

export interface Shown {
  marks: ImageMarks; selection: Selection | null; names: readonly string[]; cobb: Cobb | null; tracked: TrackedFrame | null;
  cursor: Point | null; show: boolean; spine: boolean; lowest: number;
}

export class Stage {
  private readonly context: CanvasRenderingContext2D;
  private readonly picture = document.createElement("canvas");
  private grey: Grey | null = null;
  private shown: Shown | null = null;
  private due = false;
  /** Screen pixels a radiograph's pixel, and where its (0, 0) lies on the canvas. */
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
    const same = keepView && before?.rows === grey.rows && before.columns === grey.columns;
    this.grey = grey;
    this.picture.width = grey.columns;
    this.picture.height = grey.rows;
    if (!same) { this.window = [...grey.window]; this.resize(); this.fit(); }
    this.develop();
  }

  /** The window that the radiograph opens with. */
  get natural(): [number, number] { return this.grey?.window ?? [0, 65535]; }
  get size(): Point { return this.grey ? [this.grey.columns, this.grey.rows] : [1, 1]; }
  get first(): Point { return this.grey?.first ?? [1, 0]; }

  setWindow(window: [number, number]): void {
    this.window = window;
    this.develop();
  }

  private develop(): void {
    const grey = this.grey, context = this.picture.getContext("2d");
    if (!grey || !context) return;
    const [low, high] = this.window, table = new Uint32Array(65536);
    for (let i = 0; i < 65536; i++) {
      const shade = Math.min(255, Math.max(0, Math.round(((i - low) * 255) / Math.max(1, high - low))));
      table[i] = 0xff000000 | (shade << 16) | (shade << 8) | shade;
    }
    const image = context.createImageData(grey.columns, grey.rows), pixels = new Uint32Array(image.data.buffer);
    for (let i = 0; i < pixels.length; i++) pixels[i] = table[grey.levels[i] as number] as number;
    context.putImageData(image, 0, 0);
    this.redraw();
  }

  private get ratio(): number { return window.devicePixelRatio || 1; }

  private resize(): void {
    const { clientWidth, clientHeight } = this.canvas;
    const wide = Math.max(1, Math.round(clientWidth * this.ratio)), high = Math.max(1, Math.round(clientHeight * this.ratio));
    if (this.canvas.width !== wide || this.canvas.height !== high) { this.canvas.width = wide; this.canvas.height = high; }
    if (this.fitted) this.fit(); else this.redraw();
  }

  fit(): void {
    const [columns, rows] = this.size, { clientWidth, clientHeight } = this.canvas;
    this.scale = Math.max(0.01, Math.min(clientWidth / columns, clientHeight / rows));
    this.origin = [0.5 * (clientWidth - (columns - 1) * this.scale), 0.5 * (clientHeight - (rows - 1) * this.scale)];
    this.fitted = true;
    this.redraw();
  }

  zoom(factor: number, at?: Point): void {
    const place = at ?? [0.5 * this.canvas.clientWidth, 0.5 * this.canvas.clientHeight];
    const pixel = this.toPixel(place);
    this.scale = Math.min(40, Math.max(0.02, this.scale * factor));
    this.origin = [place[0] - pixel[0] * this.scale, place[1] - pixel[1] * this.scale];
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

  toPixel(place: Point): Point { return [(place[0] - this.origin[0]) / this.scale, (place[1] - this.origin[1]) / this.scale]; }
  toPlace(pixel: Point): Point { return [pixel[0] * this.scale + this.origin[0], pixel[1] * this.scale + this.origin[1]]; }

  /** The mark under a place of the canvas: points before corners before whole vertebrae, the nearest of a kind. */
  under(place: Point): Selection | null {
    const shown = this.shown;
    if (!shown?.show) return null;
    const found: [number, Selection][] = [];
    const offer = (points: readonly Point[] | undefined, make: (i: number) => Selection): void =>
      points?.forEach((p, i) => {
        const q = this.toPlace(p), distance = Math.hypot(q[0] - place[0], q[1] - place[1]);
        if (distance < REACH) found.push([distance, make(i)]);
      });
    const marks = shown.marks;
    if (shown.spine) offer(marks.spine, (part) => ({ kind: "spine", name: "", part }));
    for (const kind of ["pelvis", "shoulder"] as const) offer(marks.supports[kind], (part) => ({ kind, name: "", part }));
    for (const [name, pair] of Object.entries(marks.pedicles)) offer(pair, (part) => ({ kind: "pedicle", name, part }));
    for (const [name, quad] of Object.entries(this.quads())) offer(quad, (part) => ({ kind: "vertebra", name, part }));
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
    const c = this.context, { ratio } = this;
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.fillStyle = "#000";
    c.fillRect(0, 0, this.canvas.clientWidth, this.canvas.clientHeight);
    if (!this.grey) return;
    // The first pixel's centre is (0, 0), so the picture begins half a pixel before.
    const [x, y] = this.toPlace([-0.5, -0.5]);
    c.imageSmoothingEnabled = this.scale < 4;
    c.imageSmoothingQuality = "high";
    c.drawImage(this.picture, x, y, this.size[0] * this.scale, this.size[1] * this.scale);
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
      this.outline(quad, chosen ? CHOSEN : measured ? MARK : TRACKED, chosen ? 2.4 : 1.4, measured ? [] : [6, 4], true);
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
      pair.forEach((p, i) => this.point(p, "", "cross", this.isChosen("pedicle", name, i)));
    if (shown.cursor) this.crosshair(shown.cursor);
  }

  private isChosen(kind: string, name: string, part: number): boolean {
    const at = this.shown?.selection;
    return at?.kind === kind && at.name === name && at.part === part;
  }

  private handle(p: Point, chosen: boolean): void {
    const c = this.context, [x, y] = this.toPlace(p), size = chosen ? HANDLE + 2.5 : HANDLE;
    c.fillStyle = chosen ? CHOSEN : "#000";
    c.strokeStyle = chosen ? "#000" : CHOSEN;
    c.lineWidth = 1.6;
    c.fillRect(x - size, y - size, 2 * size, 2 * size);
    c.strokeRect(x - size, y - size, 2 * size, 2 * size);
  }

  /** Corners that were lost get a cross, doubtful ones a question mark. */
  private paintLost(quad: Quad, quality: readonly number[] | undefined): void {
    quad.forEach((p, i) => {
      const q = quality?.[i] ?? 1;
      if (q >= (this.shown?.lowest ?? 0)) return;
      if (q > 0) return this.text("?", ...this.toPlace(p), CHOSEN, "center");
      const [x, y] = this.toPlace(p), d = 6;
      const c = this.context;
      for (const [colour, width] of [[HALO, 4], [CHOSEN, 2]] as const) {
        c.beginPath();
        c.moveTo(x - d, y - d); c.lineTo(x + d, y + d); c.moveTo(x - d, y + d); c.lineTo(x + d, y - d);
        c.strokeStyle = colour; c.lineWidth = width; c.stroke();
      }
    });
  }

  private point(p: Point, words: string, shape: "circle" | "triangle" | "diamond" | "cross", chosen: boolean): void {
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
    c.strokeStyle = chosen ? CHOSEN : MARK; c.lineWidth = 2; c.stroke();
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
    this.origin = [left + LOUPE / 2 - p[0] * LOUPE_ZOOM, top + LOUPE / 2 - p[1] * LOUPE_ZOOM];
    const [x, y] = this.toPlace([-0.5, -0.5]);
    c.drawImage(this.picture, x, y, this.size[0] * LOUPE_ZOOM, this.size[1] * LOUPE_ZOOM);
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
