// What the page asks of its server, always with this start's token. Nothing is asked of anybody else.
import { greysIn } from "../../shared/greys";
import { ask, get, send } from "../../shared/net";
import type { ImageMarks, Marks, Point, Quad } from "./marks";

export interface ImageInfo { name: string; title: string; kind: "frontal" | "lateral"; forces: (number | null)[]; roles: (string | null)[] }
export interface Session {
  version: string; subject: string; vertebrae: string[]; lowest_quality: number; images: ImageInfo[]; marks: Marks; revision: string; missing: string[];
}
export interface Grey {
  rows: number; columns: number; window: [number, number]; kind: string; first: Point; up: Point; shape: Point;
  /** left, top, right, bottom of what was sent, in pixels of the radiograph, and with how many pixels it was sent. */
  part: [number, number, number, number]; shown: Point; levels: Uint16Array;
}
/** ``words`` as every Cobb angle is told: size, half interval, levels, definition, side. */
export interface Cobb { upper: string; lower: string; region: string; words: string }
export interface Judged { vertebrae: number; problem: string; cobb: Cobb | null; curves: Cobb[] }
export interface TrackedFrame { vertebrae: Record<string, Quad>; quality: Record<string, [number, number, number, number]> }
export interface Tracking { state: "none" | "running" | "done" | "failed"; done: number; total: number; error: string; frames: TrackedFrame[] }

const query = (values: Record<string, string | number>): string =>
  new URLSearchParams(Object.entries(values).map(([key, value]) => [key, String(value)])).toString();

export const session = (): Promise<Session> => get("api/session");
export const save = (marks: Marks, revision: string): Promise<{ revision: string; missing: string[] }> =>
  send("PUT", "api/annotation", { revision, draft: { schema_version: 1, images: marks } });
export const judge = (image: string, marks: ImageMarks): Promise<Judged> => send("POST", "api/judge", { image, marks });
export const propose = (
  image: string, frame: number, points: Point[], upper: string, lower: string, kept: Record<string, Quad>,
): Promise<{ vertebrae: Record<string, Quad> }> => send("POST", "api/propose", { image, frame, points, upper, lower, kept });
export const track = (image: string): Promise<Tracking> => send("POST", "api/track", { image });
export const tracking = (image: string): Promise<Tracking> => get(`api/track?${query({ image })}`);
export const importFile = (name: string, text: string, image: string): Promise<{ marks: Marks; warnings: string[] }> =>
  send("POST", "api/import", { name, text, image });
export const exportFile = async (form: string): Promise<Blob> => (await ask("GET", `api/export?${query({ form })}`)).blob();

export async function radiograph(image: string, frame: number, [wide, tall]: Point, part?: readonly number[]): Promise<Grey> {
  return greysIn(await ask("GET", `api/radiograph?${query({ image, frame, wide, tall, ...(part ? { part: part.join() } : {}) })}`));
}
