// Which vertebrae are still as they were proposed, and which of those somebody has looked at.
import type { Marks, Quad } from "./marks";

/** By name of the radiograph; boxes as text, so that a name that moves takes along what was seen of its box. */
export class Proposals {
  private readonly proposed = new Map<string, Set<string>>();
  private readonly looked = new Map<string, Set<string>>();

  propose(key: string, quads: readonly Quad[]): void { this.proposed.set(key, new Set(quads.map(String))); }

  /** Remember that a box was looked at; whether that is new. */
  look(key: string, quad: Quad): boolean {
    if (!this.isUnseen(key, quad)) return false;
    const seen = this.looked.get(key) ?? new Set();
    this.looked.set(key, seen.add(String(quad)));
    return true;
  }

  private isUnseen(key: string, quad: Quad): boolean {
    const box = String(quad);
    return !!this.proposed.get(key)?.has(box) && !this.looked.get(key)?.has(box);
  }

  unseen(key: string, vertebrae: Record<string, Quad>): string[] {
    return Object.entries(vertebrae).filter(([, quad]) => this.isUnseen(key, quad)).map(([name]) => name);
  }

  /** Vertebrae that were put right since they were proposed; without a proposal none. */
  kept(key: string, vertebrae: Record<string, Quad>): Record<string, Quad> {
    const boxes = this.proposed.get(key);
    return boxes ? Object.fromEntries(Object.entries(vertebrae).filter(([, quad]) => !boxes.has(String(quad)))) : {};
  }

  /** Marks as they are saved: with what nobody has looked at yet. */
  told(marks: Marks): Marks {
    return Object.fromEntries(Object.entries(marks).map(([key, image]) => [key, { ...image, unseen: this.unseen(key, image.vertebrae) }]));
  }
}
