// What is measured of the body beside its radiographs: sizes of the trunk, and a scan of its skin.
import { button, h } from "../../shared/dom";
import * as api from "./api";
import { type Context, field, plain, sayId, wordsOf } from "./fields";
import { act } from "./page";
import { upload } from "./upload";

const LARGEST = 200e6;
type Make = (change: () => void) => void;

/** Breadth and depth of the trunk, by the vertebra at whose height they were taken; an empty row is none. */
export function trunk(values: api.Values, context: Context, now: Make): HTMLElement {
  const { form } = context, told = wordsOf("trunk", form), holder = (values["trunk"] ?? {}) as Record<string, api.Values>;
  const sizes = plain(plain(form.schema.properties?.["trunk"] ?? {}, form).additionalProperties ?? {}, form).properties ?? {};
  const keep = (): void => { if (Object.keys(holder).length) values["trunk"] = holder; else delete values["trunk"]; };
  const row = (level: string, record: api.Values): HTMLElement => {
    const path = `trunk.${level}`, own: Context = { ...context, changed: () => {
      for (const [name, value] of Object.entries(record)) if (value === null) delete record[name];
      if (Object.keys(record).length) holder[level] = record; else delete holder[level];
      keep();
      context.changed();
    } };
    return h("div", { class: "beside-one" }, h("h2", {}, `At the height of ${level}`), h("p", { class: "says", id: sayId(path), role: "status" }),
      h("div", { class: "grid" }, ...["breadth_mm", "depth_mm"].map((name) => field(record, name, `${path}.${name}`, sizes[name] ?? {}, own))),
      context.readOnly ? null : button("Take this height out", () => now(() => { delete holder[level]; keep(); }), { "aria-label": `Take this height out: ${level}` }));
  };
  const vertebrae = form.choices.chain.slice(0, -1), rows = h("div", {}, ...vertebrae.filter((level) => level in holder).map((level) => row(level, holder[level] ?? {})));
  const level = h("select", { id: "trunk-level" }, ...vertebrae.filter((one) => !(one in holder)).map((one) => h("option", { value: one }, one)));
  level.value = "T9" in holder ? level.value : "T9";
  const add = button("Add sizes at this height", () => {
    if (!level.value) return;
    const next = row(level.value, {});
    level.selectedOptions[0]?.remove();
    rows.append(next);
    next.querySelector("input")?.focus();
  }, { id: "trunk-add" });
  return h("details", { id: "trunk", ...(Object.keys(holder).length ? { open: true } : {}) }, h("summary", {}, told.title ?? "trunk"), h("p", { class: "soft" }, told.help ?? ""),
    h("p", { class: "says", id: sayId("trunk"), role: "status" }), rows, context.readOnly ? null : h("p", { class: "row" }, h("label", {}, "At the height of ", level), add));
}

/** The scan of the skin to be changed or taken out, or a file of one to be added. */
export function skin(key: string, values: api.Values, context: Context, now: Make, added: () => Promise<void>): HTMLElement {
  const { form } = context, told = wordsOf("skin_scan", form), there = values["skin_scan"] as api.Values | null | undefined;
  const schema = plain(form.schema.properties?.["skin_scan"] ?? {}, form).properties ?? {}, axesOf = plain(schema["axes"] ?? {}, form).properties ?? {};
  const record = there ?? { unit: null, axes: { left: null, up: null, front: null } }, own: Context = there ? context : { ...context, changed: () => undefined };
  const grid = h("div", { class: "grid" }, field(record, "unit", "skin_scan.unit", schema["unit"] ?? {}, own),
    ...["left", "up", "front"].map((axis) => field(record["axes"] as api.Values, axis, `skin_scan.axes.${axis}`, axesOf[axis] ?? {}, own)));
  const words = h("p", { class: "soft" }, told.help ?? ""), says = ["skin_scan.axes", "skin_scan"].map((path) => h("p", { class: "says", id: sayId(path), role: "status" }));
  if (there) {
    return h("details", { open: true, id: "skin" }, h("summary", {}, `${told.title ?? "skin scan"} (${String(there["file"])})`), words, ...says, grid,
      context.readOnly ? null : button("Take the scan out", () => now(() => { delete values["skin_scan"]; })));
  }
  const file = h("input", { type: "file", accept: ".stl,.obj,.ply,.vtp", id: "skin-file" }), bar = h("progress", { max: 1, value: 0, "aria-label": "Upload of the scan" });
  bar.hidden = true;
  const add = button("Add the scan", () => act(async () => {
    const given = file.files?.[0];
    if (!given) throw new Error("choose the file of the scan first");
    if (given.size > LARGEST) throw new Error(`the scan has ${(given.size / 1e6).toFixed(0)} MB; at most 200 MB are read`);
    bar.hidden = false;
    try {
      const sent = await upload([{ file: given, name: given.name }], new AbortController().signal, (done, all) => { bar.value = all ? done / all : 1; });
      try { await api.addScan(key, sent, record); } catch (error) { void api.discard(sent).catch(() => undefined); throw error; }
    } finally { bar.hidden = true; }
    await added();
  }, add), { id: "skin-add" });
  return h("details", { id: "skin" }, h("summary", {}, told.title ?? "skin scan"), words, ...says, h("p", {}, h("label", {}, "A surface as STL, OBJ, PLY or VTP: ", file)), grid, h("p", {}, add), bar);
}
