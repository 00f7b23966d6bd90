// Radiographs as they were sent, kept while there is room, and the frames beside the one in sight fetched ahead.
import { type Grey, radiograph } from "./api";
import type { Point } from "./marks";

const MOST_BYTES = 384 * 2 ** 20, SIDE_BY_SIDE = 2;

export class Pictures {
  private readonly kept = new Map<string, Grey>();
  private readonly asked = new Map<string, Promise<Grey>>();
  private bytes = 0;
  private round = 0;

  /** A frame of at most so many columns and rows. */
  async get(image: string, frame: number, most: Point): Promise<Grey> {
    const key = `${image}\n${frame}\n${most.join()}`, there = this.kept.get(key);
    if (there) {
      // The last that was used goes last.
      this.kept.delete(key);
      this.kept.set(key, there);
      return there;
    }
    const running = this.asked.get(key) ?? radiograph(image, frame, most).then((grey) => this.keep(key, grey)).finally(() => this.asked.delete(key));
    this.asked.set(key, running);
    return running;
  }

  private keep(key: string, grey: Grey): Grey {
    this.kept.set(key, grey);
    this.bytes += grey.levels.byteLength;
    for (const [old, one] of this.kept) {
      if (this.bytes <= MOST_BYTES || old === key) break;
      this.kept.delete(old);
      this.bytes -= one.levels.byteLength;
    }
    return grey;
  }

  /** Fetch the other frames, the nearest first, until there is no room or something else is asked for. */
  async ahead(image: string, frame: number, count: number, most: Point): Promise<void> {
    const round = ++this.round, first = await this.get(image, frame, most);
    const room = Math.floor(MOST_BYTES / first.levels.byteLength) - 1;
    const order = [...Array(count).keys()].sort((a, b) => Math.abs(a - frame) - Math.abs(b - frame)).slice(1, room);
    const worker = async (): Promise<void> => {
      for (let next = order.shift(); next !== undefined && round === this.round; next = order.shift()) await this.get(image, next, most);
    };
    await Promise.all(Array.from({ length: SIDE_BY_SIDE }, worker)).catch(() => undefined);
  }
}
