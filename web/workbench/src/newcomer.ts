// A new subject: files or folders dropped or chosen, or a folder on the server's machine; what they are; a name.
import { button, h } from "../../shared/dom";
import * as api from "./api";
import { act, go, problem, type Room, state } from "./page";
import { chosen, dropped, type Given, upload } from "./upload";

const NAME = "[A-Za-z0-9][A-Za-z0-9._\\-]{0,63}";

export async function newcomer(): Promise<Room> {
  const stop = new AbortController();
  const bar = h("progress", { max: 1, value: 0, "aria-label": "Upload" }), said = h("p", { role: "status", class: "soft" }), below = h("div");
  const files = h("input", { type: "file", multiple: true, class: "hidden", id: "files", "aria-label": "Choose files" });
  const folder = h("input", { type: "file", webkitdirectory: true, class: "hidden", id: "folder", "aria-label": "Choose a folder" });
  const drop = h("div", { class: "drop", id: "drop" },
    h("p", {}, "Drop the hospital's files or folders here, or a zip file of them."),
    h("div", { class: "row" }, button("Choose files", () => files.click(), { class: "main" }), button("Choose a folder", () => folder.click())),
    h("p", { class: "soft" }, "DICOM radiographs, however they are named and nested; what is none is left out. They are copied into the subject’s folder on this machine and go nowhere else."));
  bar.hidden = true;

  const take = (given: Given[]): void => act(async () => {
    if (!given.length) return;
    const total = given.reduce((sum, { file }) => sum + file.size, 0);
    if (total > state.uploadBytes) throw new Error(`${(total / 2 ** 30).toFixed(1)} GB; at most ${(state.uploadBytes / 2 ** 30).toFixed(0)} GB at a time`);
    below.replaceChildren();
    bar.hidden = false;
    try {
      const key = await upload(given, stop.signal, (done, all) => {
        bar.value = all ? done / all : 1;
        said.textContent = `${(done / 2 ** 20).toFixed(1)} of ${(all / 2 ** 20).toFixed(1)} MB`;
      });
      await look({ origin: "upload", key });
    } finally {
      bar.hidden = true;
      if (said.textContent?.includes(" MB")) said.textContent = "";
    }
  });
  const look = async (asked: api.Asked): Promise<void> => {
    said.textContent = "Reading the radiographs …";
    try { below.replaceChildren(found(asked, await api.look(asked), look)); } finally { said.textContent = ""; }
    below.querySelector("h2")?.focus();
  };
  files.addEventListener("change", () => { if (files.files) take(chosen(files.files)); });
  folder.addEventListener("change", () => { if (folder.files) take(chosen(folder.files)); });
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
    button("Read it", () => act(() => look({ origin: "source", key: select.value })))) : null;
  const element = h("section", {}, h("h1", {}, "New subject"), files, folder, drop, onDisk, bar, said, below);
  // For whoever automates the page.
  Object.assign(window, { takeFiles: take });
  return { element, leave: () => stop.abort() };
}

function found(asked: api.Asked, look: api.Look, again: (asked: api.Asked) => Promise<void>): HTMLElement {
  const title = h("h2", { tabindex: "-1" }, "What was found"), box = h("div", {}, title);
  if (look.studies.length > 1) {
    const select = h("select", { id: "study" }, h("option", { value: "" }, "choose …"), ...look.studies.map(({ label, words }) => h("option", { value: label }, words)));
    select.value = look.study ?? "";
    select.addEventListener("change", () => act(() => again({ origin: asked.origin, key: asked.key, study: select.value })));
    box.append(h("p", {}, h("label", {}, "There are several studies; which one? ", select)));
  }
  if (look.files.length) box.append(files(asked, look, again), person(asked, look));
  if (look.left_out.length) {
    box.append(h("details", {}, h("summary", {}, `${look.left_out.length} other files are left out`),
      h("ul", {}, ...look.left_out.map(({ name, why }) => h("li", {}, `${name}: ${why}`)))));
  }
  return box;
}

function files(asked: api.Asked, look: api.Look, again: (asked: api.Asked) => Promise<void>): HTMLElement {
  const rest = (view: "frontal" | "lateral"): HTMLElement | null => {
    const could = look.files.filter((file) => file.frames === 1 && (file.view === view || file.view === "" || file.use === `rest, ${view}`));
    const now = look.files.find((file) => file.use === `rest, ${view}`);
    if (could.length < 2 && now) return null;
    if (!could.length) return view === "frontal" ? h("p", { class: "warn" }, "No frontal radiograph at rest was found; it can be added later, but nothing can be estimated without it.") : null;
    const select = h("select", { id: view }, h("option", { value: "" }, "none"), ...could.map(({ name }) => h("option", { value: name }, name)));
    select.value = now?.name ?? "";
    select.addEventListener("change", () => act(() => again({ ...asked, ...(look.study ? { study: look.study } : {}), ...(select.value ? { [view]: select.value } : {}) })));
    return h("p", {}, h("label", {}, `Rest radiograph, ${view}: `, select));
  };
  return h("div", {}, h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Radiographs" },
    h("table", {}, h("thead", {}, h("tr", {}, ...["File", "Frames", "Becomes", "Why"].map((name) => h("th", { scope: "col" }, name)))),
      h("tbody", {}, ...look.files.map((file) => h("tr", file.use === "left out" ? { class: "soft" } : {}, h("td", { class: "path" }, file.name), h("td", {}, String(file.frames)), h("td", {}, h("b", {}, file.use)), h("td", {}, file.why)))))),
  rest("frontal"), rest("lateral"));
}

function person(asked: api.Asked, look: api.Look): HTMLElement {
  const name = h("input", { type: "text", id: "name", pattern: NAME, required: true, maxlength: "64", autocomplete: "off", "aria-describedby": "name-help" });
  const make = h("button", { class: "main", id: "make" }, "Make the subject");
  const form = h("form", { class: "plain" },
    h("p", {}, h("label", { for: "name" }, "Name of the subject "), name),
    h("p", { id: "name-help", class: "soft" }, "Letters, digits, '.', '_' or '-'. No person’s name: it stands in the report."),
    ...look.notes.map((note) => h("p", { class: "soft" }, note)), make);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    act(async () => {
      const { key } = await api.make({ ...asked, ...(look.study ? { study: look.study } : {}), name: name.value, person: {} });
      go(`/subject/${key}/values`);
    }, make);
  });
  return form;
}
