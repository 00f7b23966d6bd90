// What the workbench's server is asked for, and what it answers.
import { ask, get, send } from "../../shared/net";

export interface Job {
  id: string; subject: string; verb: string; options: Record<string, unknown>; state: "waiting" | "running" | "done" | "failed" | "cancelled" | "lost";
  asked: number; began: number | null; ended: number | null; status: number | null; cancel: boolean;
}
export interface Stiffness {
  /** `words` and `interval` are the value and its 95 % interval as the report tells them, "" where there is none. */
  name: string; title: string; words: string; interval: string; unit: string; determined: string | null; value: number; low: number | null; high: number | null; open_low: boolean; open_high: boolean;
}
/** Under the largest force; null where it was not measured. */
export interface Cobb { push: string; force_n: number; change_deg: number; words: string }
export interface Result { problem?: string; cobb?: Cobb | null; badge: string; lines: string[]; stiffness: Stiffness[]; doubts: string[]; rmse_mm: number }
export interface Card {
  key: string; name: string; job: Job | null; stage: "broken" | "form" | "radiographs" | "annotate" | "roles" | "run" | "done"; stage_words: string; missing: string[];
  id?: string; age?: number | null; sex?: string | null; height_cm?: number | null; pushes?: number; result?: Result | null; stale?: string[];
}
export interface Results {
  pages: { name: string; title: string }[]; pictures: { name: string; title: string }[]; result: Result | null; plan: string[]; plan_stale: string[]; parameters: string[]; stale: string[]; ticket: string;
}
export type Values = { [name: string]: unknown };
export interface Schema {
  type?: string; title?: string; description?: string; $ref?: string; $defs?: Record<string, Schema>; properties?: Record<string, Schema>; required?: string[];
  anyOf?: Schema[]; enum?: string[]; const?: unknown; items?: Schema; minimum?: number; maximum?: number; exclusiveMinimum?: number; default?: unknown; additionalProperties?: Schema;
}
/** Words where the schema takes any: `of` is "joints" or "tissue", a key of `parts`; the last of `chain` is no vertebra. */
export interface Choices { groups: { name: string; title: string; of: string }[]; parts: Record<string, { name: string; title: string }[]>; chain: string[]; populations: string[] }
export interface Said { field: string; text: string }
export interface Judged { problems: Said[]; open: Said[] }
export interface Form extends Judged { schema: Schema; words: Record<string, { title?: string; unit?: string; help?: string; picture?: string }>; priors: Record<string, number>; choices: Choices; values: Values; revision: string }
export interface Option { kind: "choice" | "number" | "switch" | "text"; title: string; example?: string; help?: string; fields?: Record<string, string>; only?: [string, string] | null; words?: Record<string, string>; low?: number; high?: number; usual?: number; unit?: string; whole?: boolean }
export interface Verb { title: string; about: string; minutes: string; options: Record<string, Option> }
export interface Look {
  studies: { label: string; words: string }[]; study: string | null; told: Values; notes: string[];
  files: { name: string; frames: number; view: string; use: string; why: string; held?: boolean }[]; left_out: { name: string; why: string }[]; left_out_in_all: number; changes?: string[];
}
export interface Asked { origin: "upload" | "source" | "none"; key: string; study?: string; frontal?: string; lateral?: string; table?: string; joined?: string[][]; subject?: string; replaces?: string }
export interface Radiographs { files: { image: string; name: string; frames: number; use: string; version: string }[]; rest: string[]; lacking: string[] }
export interface Markers { unit: string; axes: Record<string, string>; side: string; shown: Record<string, unknown> }

export const bench = (): Promise<{ version: string; read_only: boolean; upload_bytes: number }> => get("/api/bench");
export const subjects = async (): Promise<Card[]> => (await get<{ subjects: Card[] }>("/api/subjects")).subjects;
export const table = async (): Promise<string> => (await ask("GET", "/api/table.csv")).text();
export const subject = (key: string): Promise<Card> => get(`/api/subjects/${key}`);
export const remove = (key: string): Promise<{ trash: string }> => send("DELETE", `/api/subjects/${key}`);
export const removePush = (key: string, push: string): Promise<{ trash: string; lines: string[] }> => send("POST", `/api/subjects/${key}/pushes/remove`, { push });
/** A subject, a push of one, or a radiograph at rest that was replaced: `image` says which, `vertebrae` how many are marked in it. */
export interface Removed { key: string; name: string; removed: number; image: string | null; push: string | null; vertebrae: number }
export const trash = async (): Promise<Removed[]> => (await get<{ trash: Removed[] }>("/api/trash")).trash;
export const restore = (key: string): Promise<{ key: string; trash: string | null }> => send("POST", `/api/trash/${key}/restore`);
export const deleteForGood = (key: string): Promise<unknown> => send("DELETE", `/api/trash/${key}`);
export const form = (key: string): Promise<Form> => get(`/api/subjects/${key}/form`);
export const check = (values: Values): Promise<Judged> => send("POST", "/api/check", { values });
export const save = (key: string, values: Values, revision: string): Promise<Judged & { revision: string }> =>
  send("PUT", `/api/subjects/${key}/form`, { values, revision });
export interface GaugeLog {
  columns: string; notes: string[]; placed: boolean; forces_n: number[] | null; given: boolean; why: string; offset_s: number | null; low_s: number | null; high_s: number | null; open_n: number | null; explained: number | null; picture: string;
}
export const gaugeLog = (key: string, asked: Values): Promise<GaugeLog> => send("POST", `/api/subjects/${key}/log`, asked);
/** Factors are of the later visit over the earlier one. */
export interface Visits {
  same: boolean; problem: string; lines: string[];
  scatter: Record<string, { within_sd_log: number; low: number; high: number; expected_sd_log: number; detectable_factor: number; expected_factor: number; p_value: number }>;
  changes: { name: string; title: string; factor: number; low: number; high: number; detectable_factor: number; verdict: string }[];
}
export const visits = (first: string, second: string): Promise<Visits> => get(`/api/visits/${first}/${second}`);
export const verbs = (): Promise<Record<string, Verb>> => get("/api/verbs");
export const jobs = async (key: string): Promise<Job[]> => (await get<{ jobs: Job[] }>(`/api/subjects/${key}/jobs`)).jobs;
export const allJobs = async (): Promise<Job[]> => (await get<{ jobs: Job[] }>("/api/jobs")).jobs;
export const start = (key: string, verb: string, options: Values): Promise<Job> => send("POST", `/api/subjects/${key}/jobs`, { verb, options });
export const cancel = (job: string): Promise<Job> => send("POST", `/api/jobs/${job}/cancel`);
export const log = (job: string): Promise<{ lines: string[]; at: number }> => get(`/api/jobs/${job}/log`);
export const results = (key: string): Promise<Results> => get(`/api/subjects/${key}/results`);
export const pack = (key: string, nameless: boolean, burned_in_ok: boolean): Promise<{ ticket: string; bytes: number }> =>
  send("POST", `/api/subjects/${key}/zip`, { nameless, burned_in_ok });
export const sources = async (): Promise<{ key: string; name: string }[]> => (await get<{ sources: { key: string; name: string }[] }>("/api/sources")).sources;
export const look = (asked: Asked): Promise<Look> => send("POST", "/api/look", asked);
export const lookPicture = (asked: Asked, name: string): Promise<Response> => ask("POST", "/api/look/picture", JSON.stringify({ ...asked, name }));
export const discard = (upload: string): Promise<unknown> => send("DELETE", `/api/uploads/${upload}`);
export const radiographs = (key: string): Promise<Radiographs> => get(`/api/subjects/${key}/radiographs`);
/** A radiograph of a subject, or a part of it, whatever is known of its millimetres; of several frames the first. */
export const bare = (key: string, image: string, wide: number, tall: number, part = ""): Promise<Response> =>
  ask("GET", `/api/subjects/${key}/radiograph?${new URLSearchParams({ image, wide: String(wide), tall: String(tall), part }).toString()}`);
export const picture = (key: string, image: string): Promise<Response> =>
  ask("GET", `/annotate/${key}/api/radiograph?${new URLSearchParams({ image, wide: "96", tall: "128" }).toString()}`);
export const extend = (key: string, asked: Asked): Promise<{ changes: string[] }> => send("POST", `/api/subjects/${key}/radiographs`, asked);
export const replace = (key: string, asked: Asked): Promise<{ trash: string }> => send("POST", `/api/subjects/${key}/rest`, asked);
export const addView = (key: string, asked: Asked & { names: string[]; push: number; view: Values }): Promise<unknown> => send("POST", `/api/subjects/${key}/views`, asked);
export const addMarkers = (key: string, push: number, markers: Markers, text: string): Promise<unknown> => send("POST", `/api/subjects/${key}/markers`, { push, markers, text });
export const addScan = (key: string, upload: string, scan: Values): Promise<unknown> => send("POST", `/api/subjects/${key}/scan`, { upload, scan });
export const make = (asked: Asked & { name: string; person: Values }): Promise<{ key: string }> => send("POST", "/api/subjects", asked);
