// Known lengths in images, which set their millimetres where the files have none: an object's, or a vertebra's.
import { button, h } from "../../shared/dom";
import type { Values } from "./api";
import { ends } from "./ends";
import { boxed, type Context, field, plain, sayId, typed, wordsOf } from "./fields";
import { pushNamed } from "./page";

type Make = (change: () => void) => void;
const OBJECT = ["object_mm", "object_px", "plane"], KINDS: Record<string, string> = { object: "a calibration object", vertebra: "a vertebra" };
export function titleOf(image: string): string {
  const [kind, push, , view] = image.split("/");
  return kind === "rest" ? `the ${image.slice(5)} radiograph at rest` : view ? `the view ${view} of ${pushNamed(push ?? "")}` : `the pictures of ${pushNamed(push ?? "")}`;
}

/** A row for each image that has one, and what adds another. `holder` is `xray`, and `keep` puts it into the values. */
export function scales(key: string, holder: Values, pushes: Values[], context: Context, now: Make, keep: () => void): HTMLElement {
  const { form } = context, told = wordsOf("xray.scale", form), all = (holder["scale"] ?? {}) as Record<string, Values>;
  const xray = plain(form.schema.properties?.["xray"] ?? {}, form).properties ?? {};
  const schema = plain(plain(xray["scale"] ?? {}, form).additionalProperties ?? {}, form).properties ?? {};
  const settle = (): void => { if (Object.keys(all).length) holder["scale"] = all; else delete holder["scale"]; keep(); };
  const row = (image: string, record: Values, ofObject = OBJECT.some((name) => name in record)): HTMLElement => {
    const path = `xray.scale.${image}`, own: Context = { ...context, changed: () => {
      for (const [name, value] of Object.entries(record)) if (value === null) delete record[name];
      if (Object.keys(record).some((name) => name !== "plane")) all[image] = record; else delete all[image];
      settle();
      context.changed();
    } };
    const picture = h("div");
    const one = (name: string): HTMLElement => field(record, name, `${path}.${name}`, schema[name] ?? {}, own);
    const parts = ofObject ? [one("object_mm"), twoEnds(key, image, record, `${path}.object_px`, own, picture), one("plane")] : [one("vertebra"), one("width_mm")];
    return h("div", { class: "beside-one", "data-scale": image }, h("h3", {}, `In ${titleOf(image)}: ${KINDS[ofObject ? "object" : "vertebra"] ?? ""}`), h("p", { class: "says", id: sayId(path), role: "status" }),
      h("div", { class: "grid" }, ...parts), picture,
      context.readOnly ? null : button("Take this length out", () => now(() => { delete all[image]; settle(); }), { "aria-label": `Take this length out: ${titleOf(image)}` }));
  };
  const images = ["rest/frontal", "rest/lateral", ...pushes.map((push) => `push/${String(push["id"])}`)], free = images.filter((image) => !(image in all));
  const image = h("select", { id: "scale-image" }, ...free.map((one) => h("option", { value: one }, titleOf(one))));
  const kind = h("select", { id: "scale-kind" }, ...Object.entries(KINDS).map(([one, title]) => h("option", { value: one }, title)));
  const rows = h("div", {}, ...Object.entries(all).map(([name, record]) => row(name, record)));
  // What is empty yet is no value.
  const add = button("Add a known length", () => {
    if (!image.value) return;
    const next = row(image.value, {}, kind.value === "object");
    image.selectedOptions[0]?.remove();
    rows.append(next);
    next.querySelector<HTMLElement>("input, select")?.focus();
  }, { id: "scale-add" });
  return h("div", { id: "scales" }, h("h2", {}, told.title ?? "scale"), h("p", { class: "soft" }, told.help ?? ""), h("p", { class: "says", id: sayId("xray.scale"), role: "status" }), rows,
    context.readOnly || !free.length ? null : h("p", { class: "row" }, h("label", {}, "In ", image), h("label", {}, "of ", kind), add));
}

/** Two ends as two lines of column and row, typed or clicked in the picture, which is shown in `picture`. */
function twoEnds(key: string, image: string, record: Values, path: string, context: Context, picture: HTMLElement): HTMLElement {
  const text = h("textarea", { rows: "2" }), lines = (): unknown => (Array.isArray(record["object_px"]) ? record["object_px"] : []);
  const show = (): void => { text.value = (lines() as unknown[]).map((one) => (Array.isArray(one) ? one.join(", ") : String(one))).join("\n"); };
  show();
  text.addEventListener("input", () => {
    const found = text.value.split("\n").map((line) => line.trim()).filter(Boolean).map((line) => line.split(/[\s,;]+/).map(typed));
    record["object_px"] = found.length ? found : null;
    context.changed();
  });
  const open = button("Click them in the picture", () => {
    const given = (lines() as unknown[]).filter((one): one is [number, number] => Array.isArray(one) && one.length === 2 && one.every((value) => typeof value === "number"));
    picture.replaceChildren(ends(key, image, given, (two) => { record["object_px"] = two; show(); context.changed(); }));
  }, { class: "pick" });
  const made = boxed(path, text, context);
  text.addEventListener("focus", () => context.focused(path));
  if (!context.readOnly) made.append(open);
  return made;
}
