// Pictures whose X-ray geometry is not that of the others: distances and pixel of their own.
import { button, h } from "../../shared/dom";
import type { Values } from "./api";
import { type Context, field, plain, sayId, wordsOf } from "./fields";
import { titleOf } from "./scale";

/** A row for each such picture, and what adds another. `holder` is `xray`, and `keep` puts it into the values. */
export function apart(holder: Values, pushes: Values[], context: Context, now: (change: () => void) => void, keep: () => void): HTMLElement {
  const { form } = context, told = wordsOf("xray.images", form), all = (holder["images"] ?? {}) as Record<string, Values>;
  const xray = plain(form.schema.properties?.["xray"] ?? {}, form).properties ?? {};
  const schema = plain(plain(xray["images"] ?? {}, form).additionalProperties ?? {}, form).properties ?? {};
  const settle = (): void => { if (Object.keys(all).length) holder["images"] = all; else delete holder["images"]; keep(); };
  const row = (image: string, record: Values): HTMLElement => {
    const path = `xray.images.${image}`, own: Context = { ...context, changed: () => {
      for (const [name, value] of Object.entries(record)) if (value === null) delete record[name];
      if (Object.keys(record).length) all[image] = record; else delete all[image];
      settle();
      context.changed();
    } };
    return h("div", { class: "beside-one", "data-apart": image }, h("h3", {}, `For ${titleOf(image)}`), h("p", { class: "says", id: sayId(path), role: "status" }),
      h("div", { class: "grid" }, ...Object.entries(schema).map(([name, one]) => field(record, name, `${path}.${name}`, one, own))),
      context.readOnly ? null : button("Take this geometry out", () => now(() => { delete all[image]; settle(); }), { "aria-label": `Take this geometry out: ${titleOf(image)}` }));
  };
  const free = ["rest/frontal", "rest/lateral", ...pushes.flatMap(imagesOf)].filter((image) => !(image in all));
  const image = h("select", { id: "apart-image" }, ...free.map((one) => h("option", { value: one }, titleOf(one))));
  const rows = h("div", {}, ...Object.entries(all).map(([name, record]) => row(name, record)));
  // What is empty yet is no value.
  const add = button("Add its geometry", () => {
    if (!image.value) return;
    const next = row(image.value, {});
    image.selectedOptions[0]?.remove();
    rows.append(next);
    next.querySelector<HTMLElement>("input")?.focus();
  }, { id: "apart-add" });
  return h("div", { id: "apart" }, h("h2", {}, told.title ?? "images"), h("p", { class: "soft" }, told.help ?? ""), h("p", { class: "says", id: sayId("xray.images"), role: "status" }), rows,
    context.readOnly || !free.length ? null : h("p", { class: "row" }, h("label", {}, "Picture ", image), add));
}

/** A push's pictures, and those of its further views by the first of each. */
function imagesOf(push: Values): string[] {
  const image = `push/${String(push["id"])}`, views = (push["views"] ?? []) as Values[];
  return [image, ...views.map((view) => `${image}/${String((view["frames"] as unknown[] | undefined)?.[0])}/${String(view["id"])}`)];
}
