// The radiographs of a subject that is there: what it has, each with a small picture, and more of them.
import { button, h } from "../../shared/dom";
import * as api from "./api";
import { integers, typed } from "./fields";
import { type Again, intake } from "./intake";
import { act, anew, link, type Room, state, undoable } from "./page";
import { last, thumbnail } from "./picture";

/** As the annotation page shows it; a file whose millimetres are not known yet as it is. */
const shown = (key: string, image: string): Promise<Response> => api.picture(key, image).catch(() => api.bare(key, image, 96, 128));
const viewOf = (image: string): string => image.replace("rest/", "");

export async function radiographs(key: string): Promise<Room> {
  const there = h("div"), more = h("div"), said = h("p", { role: "status" });
  let room: Room | null = null, over = false, replacing: string | null = null;
  const list = async (): Promise<string[]> => {
    const { files, rest, lacking } = await api.radiographs(key);
    for (const file of files) if (rest.includes(file.image)) there.dataset[viewOf(file.image)] = file.version;
    anew(there, () => there.replaceChildren(files.length ? h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Radiographs of the subject" },
      h("table", {}, h("thead", {}, h("tr", {}, ...["Picture", "File", "Frames", "What it is", ...(state.readOnly ? [] : ["Other file"])].map((name) => h("th", { scope: "col" }, name)))),
        h("tbody", {}, ...files.map((file) => h("tr", {}, h("td", {}, thumbnail(`${key} ${file.image} ${file.version}`, () => shown(key, file.image), file.use)),
          h("td", { class: "path" }, file.name), h("td", {}, String(file.frames)), h("td", {}, file.use), state.readOnly ? null : h("td", {}, rest.includes(file.image) ? exchange(file.image) : null)))))) : h("p", { class: "soft" }, "There are no radiographs yet."),
      lacking.length ? h("div", { class: "warn", id: "lacking" }, h("p", {}, "These files do not tell all of the X-ray geometry. What they lack is given in ", link("Values, X-ray geometry", `/subject/${key}/values`), ":"), h("ul", {}, ...lacking.map((line) => h("li", {}, line)))) : ""));
    return rest;
  };
  const exchange = (image: string): HTMLElement => button("Replace …", () => act(async () => {
    replacing = image;
    said.textContent = "";
    await load();
    more.querySelector<HTMLElement>("h2")?.focus();
    more.scrollIntoView({ block: "start" });
  }), { "aria-label": `Replace …: the ${viewOf(image)} radiograph at rest` });
  const load = async (): Promise<void> => {
    const rest = await list();
    if (state.readOnly || over) return;
    if (replacing) return begin(await another(replacing, rest));
    const pushes = ((await api.form(key)).values["pushes"] ?? []) as { id: string; forces_n: unknown[] }[];
    begin(await intake({
      title: h("h2", {}, "Add radiographs or a table of pushes"), subject: key, rest,
      end: (asked, look, again) => [changes(asked, look), side(key, asked, look, pushes, again, list)],
    }));
  };
  const begin = (next: Room): void => {
    room?.leave?.();
    room = next;
    if (over) next.leave?.(); else anew(more, () => more.replaceChildren(next.element));
  };
  const changes = (asked: api.Asked, look: api.Look): HTMLElement | null => {
    if (look.studies.length > 1 && look.study === null) return null;
    const notes = look.notes.map((note) => h("p", { class: "soft" }, note));
    if (!look.changes?.length) return h("div", {}, h("p", { id: "nothing-new" }, "The subject has all of this already: there is nothing to add."), ...notes);
    const add = button("Add to the subject", () => act(async () => {
      const { changes: done } = await api.extend(key, asked);
      document.dispatchEvent(new Event("subject-changed"));
      await load();
      said.textContent = `Added: ${done.join(" ")}`;
    }, add), { class: "main", id: "add" });
    return h("div", { class: "card" }, h("p", {}, "This will be added; nothing that is there changes:"), h("ul", { id: "changes" }, ...look.changes.map((line) => h("li", {}, line))), ...notes, add);
  };
  const stay = (): void => act(async () => { replacing = null; await load(); });
  const another = (image: string, rest: string[]): Promise<Room> => {
    const view = viewOf(image);
    return intake({
      title: h("div", {}, h("h2", { tabindex: "-1" }, `Another file in place of the ${view} radiograph at rest`),
        h("p", { class: "row" }, "Nothing changes before you say so below.", button("Keep the present one", stay))),
      subject: key, rest: ["rest/frontal", "rest/lateral"].filter((one) => one !== image || !rest.includes(one)), replaces: image,
      end: (asked, look) => [instead(image, asked, look)],
    });
  };
  const instead = (image: string, asked: api.Asked, look: api.Look): HTMLElement | null => {
    const file = look.files.find((one) => one.use !== "left out"), view = viewOf(image);
    if (!file || !look.changes?.length) return null;
    const shown = (title: string, name: string, picture: HTMLElement): HTMLElement => h("figure", { class: "swap" }, h("figcaption", {}, h("b", {}, title), h("br"), name), picture);
    const take = button("Replace it", () => act(async () => {
      const { trash } = await last(() => api.replace(key, asked));
      replacing = null;
      document.dispatchEvent(new Event("subject-changed"));
      await load();
      said.textContent = `The ${view} radiograph at rest was replaced. Next it has to be annotated.`;
      undoable(`The ${view} radiograph before, with its marks, is in the trash.`, async () => {
        await api.restore(trash);
        document.dispatchEvent(new Event("subject-changed"));
        said.textContent = `The ${view} radiograph before is back, with its marks; the other one is in the trash.`;
        await load();
      });
    }, take), { class: "main", id: "replace" });
    return h("div", { class: "card" }, h("div", { class: "row" },
      shown("Now", image + ".dcm", thumbnail(`${key} ${image} ${there.dataset[view] ?? ""}`, () => api.picture(key, image), `present ${view} radiograph`)), h("span", { "aria-hidden": "true" }, "→"),
      shown("Then", file.name, thumbnail(`${asked.key} ${file.name}`, () => api.lookPicture(asked, file.name), `new ${view} radiograph`))),
      h("ul", { id: "changes" }, ...look.changes.map((line) => h("li", {}, line))), ...look.notes.map((note) => h("p", { class: "warn" }, note)), h("p", { class: "row" }, take, button("Keep the present one", stay)));
  };
  await load();
  return { element: h("div", {}, there, said, more), leave: () => { over = true; room?.leave?.(); } };
}

/** Radiographs that show a push from another side, taken under the forces of some of its frames. */
function side(key: string, asked: api.Asked, look: api.Look, pushes: { id: string; forces_n: unknown[] }[], again: Again, list: () => Promise<unknown>): HTMLElement | null {
  const free = look.files.filter((file) => !file.held);
  if (!free.length || !pushes.length) return null;
  const of = (id: string, label: string, box: HTMLElement): HTMLElement => h("div", { class: "field" }, h("label", { for: id }, label), box);
  const push = h("select", { id: "view-push" }, ...pushes.map((one, i) => h("option", { value: String(i) }, `${one.id} (${one.forces_n.length} frames, from 0)`)));
  const kind = h("select", { id: "view-kind" }, ...["lateral", "frontal"].map((one) => h("option", { value: one }, one)));
  const name = h("input", { type: "text", id: "view-id", autocomplete: "off", value: "side" });
  const frames = h("input", { type: "text", id: "view-frames", autocomplete: "off" }), turned = h("input", { type: "text", id: "view-turned", inputmode: "decimal", class: "number" });
  const boxes = free.map((file) => h("input", { type: "checkbox", value: file.name }));
  const add = button("Add the view", () => act(async () => {
    const names = boxes.filter((box) => box.checked).map((box) => box.value), turn = typed(turned.value);
    if (!names.length) throw new Error("mark the radiographs of the view first");
    await api.addView(key, { ...asked, names, push: Number(push.value), view: { id: name.value, kind: kind.value, frames: integers(frames.value), ...(turn === null ? {} : { turned_deg: turn }) } });
    document.dispatchEvent(new Event("subject-changed"));
    await Promise.all([again({}), list()]);
  }, add), { id: "add-view" });
  return h("details", {}, h("summary", {}, "Some show a push from another side"),
    h("p", { class: "soft" }, "Lateral or oblique radiographs of the pushed patient, each taken under the force of one of the push’s frames."),
    h("div", {}, ...free.map((file, i) => h("p", {}, h("label", {}, boxes[i] as HTMLElement, ` ${file.name}`)))),
    h("div", { class: "grid" }, of("view-push", "Push", push), of("view-kind", "What they are, or are turned from", kind), of("view-id", "Name of the view", name),
      of("view-frames", "Frames of the push, one a radiograph: 0, 3", frames), of("view-turned", "Turn of the patient to the left, degrees (-40 to 40)", turned)), add);
}
