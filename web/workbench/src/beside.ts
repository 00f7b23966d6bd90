// What a push has beside its frames: views from other sides and markers on the skin, in the form.
import { button, h } from "../../shared/dom";
import * as api from "./api";
import { boxed, type Context, field, integers, plain, sayId, wordsOf } from "./fields";
import { act } from "./page";

const LARGEST = 2 ** 20;
type Make = (change: () => void) => void;

/** The views of a push, each to be changed or taken out; new ones come with their radiographs. */
export function views(push: api.Values, path: string, schema: api.Schema, context: Context, now: Make): HTMLElement | null {
  const all = (push["views"] ?? []) as api.Values[], { form } = context, told = plain(plain(schema.properties?.["views"] ?? {}, form).items ?? {}, form).properties ?? {};
  if (!all.length) return null;
  return h("details", { open: true }, h("summary", {}, wordsOf(`${path}.views`, form).title ?? "views"), h("p", { class: "soft" }, wordsOf(`${path}.views`, form).help ?? ""),
    ...all.map((view, i) => {
      const here = `${path}.views[${i}]`, frames = h("input", { type: "text", autocomplete: "off" });
      frames.value = ((view["frames"] ?? []) as unknown[]).join(", ");
      frames.addEventListener("input", () => { view["frames"] = integers(frames.value); context.changed(); });
      const own: Context = { ...context, changed: () => { if (view["turned_deg"] === null) delete view["turned_deg"]; context.changed(); } };
      return h("div", { class: "beside-one" }, h("h2", {}, `View ${String(view["id"])} (${String(view["files"])})`), h("p", { class: "says", id: sayId(here), role: "status" }),
        h("div", { class: "grid" }, field(view, "kind", `${here}.kind`, told["kind"] ?? {}, own), boxed(`${here}.frames`, frames, own), field(view, "turned_deg", `${here}.turned_deg`, told["turned_deg"] ?? {}, own)),
        context.readOnly ? null : button("Take this view out", () => now(() => { all.splice(i, 1); if (!all.length) delete push["views"]; })));
    }));
}

/** The markers of a push to be changed or taken out, or a table of them to be added. */
export function markers(key: string, push: api.Values, number: number, schema: api.Schema, context: Context, now: Make, added: () => Promise<void>): HTMLElement {
  const { form } = context, path = `pushes[${number}].markers`, there = push["markers"] as api.Values | undefined;
  const told = plain(schema.properties?.["markers"] ?? {}, form).properties ?? {}, axesOf = plain(told["axes"] ?? {}, form).properties ?? {};
  const record = there ?? { unit: null, axes: { left: null, up: null, front: null }, side: null, shown: {} }, own: Context = there ? context : { ...context, changed: () => undefined };
  const shown = h("textarea", { rows: "3" });
  shown.value = Object.entries((record["shown"] ?? {}) as Record<string, unknown>).map(([name, place]) => `${name}, ${Array.isArray(place) ? place.join(", ") : String(place)}`).join("\n");
  shown.addEventListener("input", () => { record["shown"] = places(shown.value); own.changed(); });
  const grid = h("div", { class: "grid" }, field(record, "unit", `${path}.unit`, told["unit"] ?? {}, own),
    ...["left", "up", "front"].map((axis) => field(record["axes"] as api.Values, axis, `${path}.axes.${axis}`, axesOf[axis] ?? {}, own)),
    field(record, "side", `${path}.side`, told["side"] ?? {}, own), boxed(`${path}.shown`, shown, own));
  const words = h("p", { class: "soft" }, wordsOf(path, form).help ?? "");
  if (there) {
    return h("details", { open: true }, h("summary", {}, `${wordsOf(path, form).title ?? "markers"} (${String(there["file"])})`), words, h("p", { class: "says", id: sayId(path), role: "status" }), grid,
      context.readOnly ? null : button("Take the markers out", () => now(() => { delete push["markers"]; })));
  }
  const file = h("input", { type: "file", accept: ".csv,text/csv", id: `markers-${number}-file` });
  const add = button("Add the markers", () => act(async () => {
    const given = file.files?.[0];
    if (!given) throw new Error("choose the table of the markers first");
    if (given.size > LARGEST) throw new Error(`the table has ${(given.size / 2 ** 20).toFixed(1)} MB; at most 1 MB is read`);
    await api.addMarkers(key, number, record as unknown as api.Markers, await given.text());
    await added();
  }, add), { id: `markers-${number}-add` });
  return h("details", {}, h("summary", {}, wordsOf(path, form).title ?? "markers"), words,
    h("p", {}, h("label", {}, "A table with the columns marker, frame, x, y, z (CSV): ", file)), grid, h("p", {}, add));
}

/** Lines "marker, column, row"; a line that is none stays as it is, and the check says so. */
function places(text: string): Record<string, unknown> {
  return Object.fromEntries(text.split("\n").map((line) => line.trim()).filter(Boolean).map((line) => {
    const found = /^([^,;\s]+)[\s,;]+([-+]?[\d.]+)[\s,;]+([-+]?[\d.]+)$/.exec(line);
    return found ? [found[1], [Number(found[2]), Number(found[3])]] : [line, "no column and row"];
  }) as [string, unknown][]);
}
