// Radiographs on their way in: dropped, chosen or in a folder on the server's machine; what they are, and what to make of them.
import { button, h } from "../../shared/dom";
import * as api from "./api";
import { act, anew, problem, type Room, state, undoable } from "./page";
import { thumbnail } from "./picture";
import { chosen, dropped, type Given, upload } from "./upload";

const LARGEST_TABLE = 2 ** 20;
const MANUAL = "file,frame,force_n,side,level,d21_mm,d31_mm";
type Change = { [K in keyof api.Asked]?: api.Asked[K] | undefined };
/** Ends the offer to take a push apart, which is of no use without the files. */
let settled: () => void = () => undefined;
export type Again = (change: Change) => Promise<void>;
export interface Purpose {
  title: HTMLElement | null;
  /** The subject that they are added to, and which radiographs at rest it has. */
  subject?: string;
  /** Of these, the one whose place one of the files takes. */
  replaces?: string;
  rest: string[];
  /** What is below the files that were found; `used` says that the server has taken the upload up. */
  end: (asked: api.Asked, look: api.Look, again: Again, used: () => void) => (HTMLElement | null)[];
}

export async function intake(purpose: Purpose): Promise<Room> {
  const stop = new AbortController(), uploads: string[] = [];
  // What was asked last, and of what the answer is in sight.
  let asked: api.Asked | null = null, answered: api.Asked | null = null, turn = 0, table: string | null = null;
  const bar = h("progress", { max: 1, value: 0, "aria-label": "Upload" }), said = h("p", { role: "status", class: "soft" }), below = h("div");
  const files = h("input", { type: "file", multiple: true, class: "hidden", id: "files", "aria-label": "Choose files", tabindex: "-1" });
  const folder = h("input", { type: "file", webkitdirectory: true, class: "hidden", id: "folder", "aria-label": "Choose a folder", tabindex: "-1" });
  const drop = h("div", { class: "drop", id: "drop" },
    h("p", {}, "Drop the hospital’s files or folders here, or a zip file of them."),
    h("div", { class: "row" }, button("Choose files", () => files.click(), { class: "main" }), button("Choose a folder", () => folder.click())),
    h("p", { class: "soft" }, "DICOM radiographs, however they are named and nested; what is none is left out. They are copied into the subject’s folder on this machine and go nowhere else."));
  bar.hidden = true;

  const take = (given: Given[]): void => act(async () => {
    if (!given.length) return;
    const total = given.reduce((sum, { file }) => sum + file.size, 0);
    if (total > state.uploadBytes) throw new Error(`${(total / 2 ** 30).toFixed(1)} GB; at most ${(state.uploadBytes / 2 ** 30).toFixed(0)} GB at a time`);
    below.replaceChildren();
    settled();
    bar.hidden = false;
    try {
      const key = await upload(given, stop.signal, (done, all) => {
        bar.value = all ? done / all : 1;
        said.textContent = `${(done / 2 ** 20).toFixed(1)} of ${(all / 2 ** 20).toFixed(1)} MB`;
      });
      uploads.push(key);
      await begin("upload", key);
    } catch (error) {
      // Whoever has left has given it up.
      if (!stop.signal.aborted) throw error;
    } finally {
      bar.hidden = true;
      if (said.textContent?.includes(" MB")) said.textContent = "";
    }
  });
  const begin = (origin: "upload" | "source" | "none", key: string): Promise<void> => {
    asked = answered = { origin, key, ...(purpose.subject ? { subject: purpose.subject } : {}), ...(purpose.replaces ? { replaces: purpose.replaces } : {}), ...(table === null ? {} : { table }) };
    return again({});
  };
  /** Ask again, with what was chosen; what is undefined is chosen no longer. */
  const again: Again = async (change) => {
    const next = Object.fromEntries(Object.entries({ ...asked, ...change }).filter(([, value]) => value !== undefined)) as unknown as api.Asked;
    const mine = ++turn;
    asked = next;
    said.textContent = "Reading the radiographs …";
    try {
      const look = await api.look(next);
      // Something else was chosen meanwhile: its answer counts, whichever comes first.
      if (mine !== turn) return;
      answered = next;
      anew(below, () => below.replaceChildren(found(purpose, next, look, again, () => { uploads.length = 0; })));
    } catch (error) {
      if (mine !== turn) return;
      asked = answered;
      throw error;
    } finally { if (mine === turn) said.textContent = ""; }
    if (!document.activeElement?.closest("#found select, #found button")) below.querySelector("h2")?.focus();
  };
  files.addEventListener("change", () => { if (files.files) take(chosen(files.files)); });
  folder.addEventListener("change", () => { if (folder.files) take(chosen(folder.files)); });
  // The same file may be chosen again, once it was put right.
  for (const box of [files, folder]) box.addEventListener("click", () => { box.value = ""; });
  for (const name of ["dragenter", "dragover"]) drop.addEventListener(name, (event) => { event.preventDefault(); drop.dataset["over"] = "true"; });
  for (const name of ["dragleave", "drop"]) drop.addEventListener(name, () => { delete drop.dataset["over"]; });
  drop.addEventListener("drop", (event) => {
    event.preventDefault();
    const items = event.dataTransfer?.items;
    if (items) void dropped(items).then(take, problem);
  });
  const here = await api.sources();
  const select = h("select", { id: "source" }, ...here.map(({ key, name }) => h("option", { value: key }, name)));
  const onDisk = here.length ? h("p", { class: "row" }, h("label", {}, "Or a folder on this machine: ", select),
    button("Read it", () => act(() => begin("source", select.value)), { id: "read-source" })) : null;
  const setTable = (text: string | null): Promise<void> => {
    table = text;
    without.hidden = text === null;
    if (text === null) tableFile.value = "";
    if (asked?.origin === "none" && text === null) {
      asked = null;
      below.replaceChildren();
    }
    return asked ? again({ table: text ?? undefined }) : text !== null && purpose.subject ? begin("none", "") : Promise.resolve();
  };
  const tableFile = h("input", { type: "file", accept: ".csv,text/csv", id: "table" });
  const without = button("Without the table", () => act(() => setTable(null)), { id: "without-table" });
  without.hidden = true;
  tableFile.addEventListener("click", () => { tableFile.value = ""; });
  tableFile.addEventListener("change", () => act(async () => {
    const given = tableFile.files?.[0];
    if (!given) return;
    if (given.size > LARGEST_TABLE) throw new Error(`the table has ${(given.size / 2 ** 20).toFixed(1)} MB; at most 1 MB is read`);
    await setTable(await given.text());
  }));
  const tables = h("details", {}, h("summary", {}, "A table of pushes and forces"), h("p", { class: "row" }, h("label", {}, "CSV file: ", tableFile), without),
    h("p", { class: "soft" }, `A row a frame, with the columns ${MANUAL}, and perhaps role and push. A file is named by the end of its path that no other has. With a table only what it names is a push.`));
  const element = h("section", {}, purpose.title, files, folder, drop, onDisk, purpose.replaces ? null : tables, bar, said, below);
  // For whoever automates the page.
  Object.assign(window, { takeFiles: take });
  return { element, leave: () => { settled(); stop.abort(); for (const key of uploads) void api.discard(key).catch(() => undefined); } };
}

function found(purpose: Purpose, asked: api.Asked, look: api.Look, again: Again, used: () => void): HTMLElement {
  const title = h("h2", { tabindex: "-1" }, "What was found"), box = h("div", { id: "found" }, title);
  if (look.studies.length > 1) {
    const select = h("select", { id: "study" }, h("option", { value: "" }, "choose …"), ...look.studies.map(({ label, words }) => h("option", { value: label }, words)));
    select.value = look.study ?? "";
    select.addEventListener("change", () => act(() => again({ study: select.value, frontal: undefined, lateral: undefined, joined: undefined })));
    box.append(h("p", {}, h("label", {}, "There are several studies; which one? ", select)));
  }
  if (look.files.length) box.append(sorted(purpose, asked, look, again));
  if (look.files.length || asked.origin === "none") box.append(...purpose.end(asked, look, again, used).filter((one) => one !== null));
  if (look.left_out.length) {
    box.append(h("details", {}, h("summary", {}, look.left_out_in_all === 1 ? "1 other file is left out" : `${look.left_out_in_all} other files are left out`),
      h("ul", {}, ...look.left_out.map(({ name, why }) => h("li", {}, `${name}: ${why}`)),
        look.left_out_in_all > look.left_out.length ? h("li", {}, `and ${look.left_out_in_all - look.left_out.length} more`) : null)));
  }
  return box;
}

function sorted(purpose: Purpose, asked: api.Asked, look: api.Look, again: Again): HTMLElement {
  const rest = (view: "frontal" | "lateral"): HTMLElement | null => {
    if (purpose.rest.includes(`rest/${view}`)) return null;
    const could = look.files.filter((file) => file.frames === 1 && !file.held && (file.view === view || file.view === "" || file.use === `rest, ${view}`));
    const now = look.files.find((file) => file.use === `rest, ${view}`);
    if (could.length < 2 && now) return null;
    if (!could.length) return purpose.replaces ? h("p", { class: "warn" }, `None of these files can take its place: wanted a ${view} radiograph of one frame.`) : view === "frontal" ? h("p", { class: "warn" }, "No frontal radiograph at rest was found; it can be added later, but nothing can be estimated without it.") : null;
    const select = h("select", { id: view }, h("option", { value: "" }, "none"), ...could.map(({ name }) => h("option", { value: name }, name)));
    select.value = now?.name ?? "";
    select.addEventListener("change", () => act(() => again({ [view]: select.value || undefined })));
    return h("p", {}, h("label", {}, `Rest radiograph, ${view}: `, select));
  };
  const small = (name: string, use: string): HTMLElement => thumbnail(`${asked.key} ${name}`, () => api.lookPicture(asked, name), use);
  const free = purpose.replaces ? [] : look.files.filter(single), mark = free.length > 1;
  const boxes = new Map(free.map((file) => [file.name, h("input", { type: "checkbox", value: file.name, "aria-label": `Mark ${file.name}` })]));
  return h("div", {}, h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Radiographs" },
    h("table", {}, h("thead", {}, h("tr", {}, ...[...(mark ? ["Mark"] : []), "Picture", "File", "Frames", "Becomes", "Why"].map((name) => h("th", { scope: "col" }, name)))),
      h("tbody", {}, ...look.files.map((file) => h("tr", file.use === "left out" ? { class: "soft" } : {}, mark ? h("td", {}, boxes.get(file.name) ?? null) : null, h("td", {}, small(file.name, file.use)), h("td", { class: "path" }, file.name), h("td", {}, String(file.frames)), h("td", {}, h("b", {}, file.use)), h("td", {}, file.why)))))),
  mark || asked.joined?.length ? join([...boxes.values()], asked, look, again) : null, rest("frontal"), rest("lateral"));
}

/** Whether a radiograph can be a frame of a push that comes as single pictures. */
const single = (file: api.Look["files"][number]): boolean => file.frames === 1 && !file.held && file.view !== "lateral";

/** Single pictures made one push, and taken apart again; their order is the server's. */
function join(boxes: HTMLInputElement[], asked: api.Asked, look: api.Look, again: Again): HTMLElement {
  const groups = asked.joined ?? [], frameOf = (name: string): number => Number(/, frame (\d+)$/.exec(look.files.find((file) => file.name === name)?.use ?? "")?.[1] ?? 0);
  const without = (i: number): Promise<void> => { const left = groups.filter((_, k) => k !== i); return again({ joined: left.length ? left : undefined }); };
  const make = button("Make one push of the marked pictures", () => act(async () => {
    const names = boxes.filter((box) => box.checked).map((box) => box.value);
    if (names.length < 2) throw new Error("mark two or more single pictures of the push first");
    // A picture is in one push.
    const left = groups.map((group) => group.filter((name) => !names.includes(name))).filter((group) => group.length > 1);
    await again({ joined: [...left, names] });
    settled = undoable(`${names.length} pictures are one push now.`, () => again({ joined: groups.length ? groups : undefined }));
  }, make), { id: "join" });
  return h("div", { id: "joined" }, ...groups.map((group, i) => h("p", { class: "row" },
    h("span", {}, `One push of ${group.length} pictures, from the first frame on: ${[...group].sort((one, other) => frameOf(one) - frameOf(other)).join(", ")}`),
    button("Take it apart", () => act(() => without(i)), { "aria-label": `Take it apart: the push of ${group.length} pictures` }))),
  boxes.length > 1 ? h("div", {}, h("p", { class: "row" }, make), h("p", { class: "soft" }, "For a push whose frames came as a file each, where they were not recognised. They are put in the order of their times, without these by the numbers in their headers; where no header has either, by the files’ names.")) : null);
}
