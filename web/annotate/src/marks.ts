// What is marked, as plain data that never changes in place, and its history.
export type Point = [number, number];
export type Quad = [Point, Point, Point, Point];
export type Support = "pelvis" | "shoulder";
export interface ImageMarks {
  vertebrae: Record<string, Quad>;
  supports: Partial<Record<Support, Point[]>>;
  pedicles: Record<string, [Point, Point]>;
  spine: Point[];
  /** The vertebrae of the first and the last of ``spine``, where somebody has said them; kept with a draft alone. */
  ends?: [string, string] | null;
  /** Of the vertebrae, those that nobody has looked at since they were proposed; told and saved, not changed here. */
  unseen?: string[];
  /** Of vertebrae with one pedicle set by hand the other, 0 left or 1 right, which is a guess; told and saved likewise. */
  guessed?: Record<string, number>;
}
export type Marks = Record<string, ImageMarks>;
export const NOTHING: ImageMarks = { vertebrae: {}, supports: {}, pedicles: {}, spine: [] };

/** What is selected. ``part`` of a vertebra: 0 to 3 a corner, -1 the whole; of other marks the point's index. */
export interface Selection { kind: "vertebra" | "pedicle" | "spine" | Support; name: string; part: number }

export const centre = (points: readonly Point[]): Point => {
  const sum = points.reduce<Point>((a, p) => [a[0] + p[0], a[1] + p[1]], [0, 0]);
  return [sum[0] / points.length, sum[1] / points.length];
};
export const moved = (p: Point, by: Point): Point => [rounded(p[0] + by[0]), rounded(p[1] + by[1])];
const rounded = (x: number): number => Math.round(x * 100) / 100;

/** The points of a selection, or none if it is gone. */
export function selected(marks: ImageMarks, at: Selection): Point[] {
  switch (at.kind) {
    case "vertebra": {
      const quad = marks.vertebrae[at.name];
      return !quad ? [] : at.part < 0 ? [...quad] : [quad[at.part] as Point];
    }
    case "pedicle": return marks.pedicles[at.name]?.slice(at.part, at.part + 1) ?? [];
    case "spine": return marks.spine.slice(at.part, at.part + 1);
    default: return (marks.supports[at.kind] ?? []).slice(at.part, at.part + 1);
  }
}

/** Marks with what is selected carried through ``change``. */
export function changed(marks: ImageMarks, at: Selection, change: (p: Point) => Point): ImageMarks {
  const each = (points: readonly Point[]): Point[] => points.map((p, i) => (at.part < 0 || i === at.part ? change(p) : p));
  switch (at.kind) {
    case "vertebra": {
      const quad = marks.vertebrae[at.name];
      return quad ? { ...marks, vertebrae: { ...marks.vertebrae, [at.name]: each(quad) as Quad } } : marks;
    }
    case "pedicle": {
      const pair = marks.pedicles[at.name];
      return pair ? { ...marks, pedicles: { ...marks.pedicles, [at.name]: each(pair) as [Point, Point] } } : marks;
    }
    case "spine": return { ...marks, spine: each(marks.spine) };
    default: return { ...marks, supports: { ...marks.supports, [at.kind]: each(marks.supports[at.kind] ?? []) } };
  }
}

/** Marks without what is selected; of a vertebra all of it goes: it counts as not visible. */
export function removed(marks: ImageMarks, at: Selection): ImageMarks {
  const others = (points: readonly Point[]): Point[] => points.filter((_, i) => i !== at.part);
  switch (at.kind) {
    case "vertebra": return { ...marks, vertebrae: without(marks.vertebrae, at.name) };
    case "pedicle": return { ...marks, pedicles: without(marks.pedicles, at.name) };
    case "spine": return { ...marks, spine: others(marks.spine) };
    default: {
      const left = others(marks.supports[at.kind] ?? []);
      return { ...marks, supports: left.length ? { ...marks.supports, [at.kind]: left } : without(marks.supports, at.kind) };
    }
  }
}

export function without<T>(record: T, key: string): T {
  const { [key as keyof T]: _, ...rest } = record;
  return rest as T;
}

/** All names one level up (-1) or down (+1), or null where one would leave the spine. */
export function renamed(marks: ImageMarks, names: readonly string[], step: number): ImageMarks | null {
  const shift = <T>(record: Record<string, T>): Record<string, T> | null => {
    const entries = Object.entries(record).map(([name, value]) => [names[names.indexOf(name) + step], value] as const);
    return entries.some(([name]) => name === undefined) ? null : (Object.fromEntries(entries) as Record<string, T>);
  };
  const vertebrae = shift(marks.vertebrae), pedicles = shift(marks.pedicles);
  // The points stay where they are, so that their vertebrae have other names, too.
  const ends = marks.ends?.map((name) => names[names.indexOf(name) + step] ?? name) as [string, string] | undefined;
  return vertebrae && pedicles ? { ...marks, vertebrae, pedicles, ...(ends && { ends }) } : null;
}

/** A box for a vertebra that has none: between its neighbours, or beyond the last one; null without two others. */
export function guessed(marks: ImageMarks, names: readonly string[], name: string): Quad | null {
  const at = names.indexOf(name);
  const have = names.map((n, i) => [i, marks.vertebrae[n]] as const).filter((entry): entry is readonly [number, Quad] => !!entry[1]);
  if (have.length < 2) return null;
  const near = [...have].sort((a, b) => Math.abs(a[0] - at) - Math.abs(b[0] - at) || a[0] - b[0]);
  const above = near.find(([i]) => i < at), below = near.find(([i]) => i > at);
  const [a, b] = above && below ? [above, below] : [near[0] as (typeof near)[0], near[1] as (typeof near)[0]];
  const share = (at - a[0]) / (b[0] - a[0]);
  // Places go along the line through both, sizes stay between them.
  const size = Math.min(1, Math.max(0, share));
  const ca = centre(a[1]), cb = centre(b[1]);
  return [0, 1, 2, 3].map((k) => {
    const pa = a[1][k] as Point, pb = b[1][k] as Point;
    const part = (i: 0 | 1): number =>
      ca[i] + share * (cb[i] - ca[i]) + (1 - size) * (pa[i] - ca[i]) + size * (pb[i] - cb[i]);
    return [rounded(part(0)), rounded(part(1))] as Point;
  }) as Quad;
}

/** The uppermost and the lowest vertebra that are marked; null without any. */
export function outermost(marks: ImageMarks, names: readonly string[]): [string, string] | null {
  const have = names.filter((name) => marks.vertebrae[name]), [first, last] = [have[0], have[have.length - 1]];
  return first && last ? [first, last] : null;
}

interface Step { marks: Marks; image: string; words: string }

/** Undo and redo over whole states; they share what did not change. */
export class History {
  private past: Step[] = [];
  private future: Step[] = [];
  constructor(public marks: Marks) {}

  commit(next: Marks, image: string, words: string): void {
    this.past.push({ marks: this.marks, image, words });
    if (this.past.length > 1000) this.past.shift();
    this.future = [];
    this.marks = next;
  }
  get canUndo(): boolean { return this.past.length > 0; }
  get canRedo(): boolean { return this.future.length > 0; }
  /** The step taken back, or null. */
  undo(): Step | null { return this.turn(this.past, this.future); }
  redo(): Step | null { return this.turn(this.future, this.past); }
  private turn(from: Step[], to: Step[]): Step | null {
    const step = from.pop();
    if (!step) return null;
    to.push({ ...step, marks: this.marks });
    this.marks = step.marks;
    return step;
  }
}
