// What is still as it was proposed, and what of that somebody has looked at: boxes of vertebrae, or points.
import type { Point, Quad } from "./marks";

/** By name of the radiograph; marks as text, so that a name that moves takes along what was seen of its mark. */
export class Proposals<T extends Quad | Point> {
  private readonly proposed = new Map<string, Set<string>>();
  private readonly looked = new Map<string, Set<string>>();

  /** Those of earlier proposals stay proposed: an undo brings them back. */
  propose(key: string, marks: readonly T[]): void { this.proposed.set(key, new Set([...(this.proposed.get(key) ?? []), ...marks.map(String)])); }

  /** One more, at which nobody has looked. */
  add(key: string, mark: T): void {
    this.propose(key, [mark]);
    this.looked.get(key)?.delete(String(mark));
  }

  /** Remember that a mark was looked at; whether that is new. */
  look(key: string, mark: T): boolean {
    if (!this.isUnseen(key, mark)) return false;
    const seen = this.looked.get(key) ?? new Set();
    this.looked.set(key, seen.add(String(mark)));
    return true;
  }

  isUnseen(key: string, mark: T): boolean {
    const text = String(mark);
    return !!this.proposed.get(key)?.has(text) && !this.looked.get(key)?.has(text);
  }

  unseen(key: string, marks: Record<string, T>): string[] {
    return Object.entries(marks).filter(([, mark]) => this.isUnseen(key, mark)).map(([name]) => name);
  }

  /** Marks that are not as they were proposed here: put right, imported, or saved before the page was opened. */
  kept(key: string, marks: Record<string, T>): Record<string, T> {
    const texts = this.proposed.get(key);
    return Object.fromEntries(Object.entries(marks).filter(([, mark]) => !texts?.has(String(mark))));
  }
}
