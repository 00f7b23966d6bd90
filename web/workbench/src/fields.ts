// Fields from the schema of subject.json: one function a kind of value, each with its unit and what is wrong with it.
import { h } from "../../shared/dom";
import type { Form, Schema, Values } from "./api";

export interface Context { form: Form; readOnly: boolean; changed: () => void; focused: (field: string) => void }

/** A schema without references and without "or nothing". */
export function plain(schema: Schema, form: Form): Schema {
  let found = schema;
  for (let i = 0; i < 6; i++) {
    const kept: Schema = found.default === undefined ? {} : { default: found.default };
    if (found.$ref) found = { ...kept, ...(form.schema.$defs?.[found.$ref.split("/").pop() ?? ""] ?? {}) };
    else if (found.anyOf) found = { ...kept, ...(found.anyOf.find((one) => one.type !== "null") ?? {}) };
    else break;
  }
  return found;
}

/** "pushes[0].d21_mm" as it stands in the words: "pushes.d21_mm". */
export const wordsOf = (path: string, form: Form): { title?: string; unit?: string; help?: string; picture?: string } =>
  form.words[path.replace(/\[\d+\]/g, "").replace(/^trunk\.[A-Z]\d+/, "trunk").replace(/^xray\.scale\..*\.(\w+)$/, "xray.scale.$1").replace(/^xray\.images\..*\.(\w+)$/, "xray.$1")] ?? {};

const spoken = (name: string): string => name.replace(/_(mm|n|cm|kg|deg)$/, "").replaceAll("_", " ");
const idOf = (path: string): string => `f-${path.replace(/[^A-Za-z0-9]/g, "-")}`;
export const sayId = (path: string): string => `${idOf(path)}-says`;

export function limits(schema: Schema): string {
  const low = schema.minimum ?? schema.exclusiveMinimum, high = schema.maximum;
  return low !== undefined && high !== undefined ? `${low} to ${high}` : low !== undefined ? `from ${low}` : high !== undefined ? `up to ${high}` : "";
}

/** What somebody typed as a number; what is none stays as it is, and the check says so. */
export function typed(text: string): number | string | null {
  const tidy = text.trim().replace(",", ".");
  if (tidy === "") return null;
  return /^[+-]?(\d+\.?\d*|\.\d+)$/.test(tidy) ? Number(tidy) : text.trim();
}

export function input(holder: Values | unknown[], name: string | number, path: string, schema: Schema, context: Context, label?: string): HTMLElement {
  const values = holder as Record<string | number, unknown>, id = idOf(path), now = values[name];
  const set = (value: unknown): void => {
    // What was never there and is empty stays away; a gap stays a gap.
    if (value === null && !(name in values)) return;
    if (value === null && now === undefined) delete values[name]; else values[name] = value;
    context.changed();
  };
  const given = { id, "aria-describedby": sayId(path), disabled: context.readOnly, onfocus: () => context.focused(path), ...(label ? { "aria-label": label } : {}) };
  const words = schema.enum ?? (typeof schema.const === "string" ? [schema.const] : null);
  if (words) {
    const select = h("select", given, h("option", { value: "" }, now === undefined ? `as usual${schema.default ? `: ${String(schema.default)}` : ""}` : "not known yet"), ...words.map((one) => h("option", { value: one }, one)));
    select.value = typeof now === "string" ? now : "";
    select.addEventListener("change", () => set(select.value || null));
    return select;
  }
  const box = h("input", { type: "text", autocomplete: "off", ...(schema.type === "string" ? {} : { inputmode: "decimal", class: "number" }), ...given });
  box.value = now === null || now === undefined ? "" : String(now);
  box.addEventListener("input", () => set(schema.type === "string" ? box.value || null : typed(box.value)));
  return box;
}

/** Whole numbers from 0, with commas or spaces; what is no such number stays as it is, and the check says so. */
export const integers = (text: string): (number | string)[] => text.split(/[\s,;]+/).filter(Boolean).map((one) => (/^\d{1,4}$/.test(one) ? Number(one) : one));

/** A field of any kind: its words, the box, and where the check puts what is wrong. */
export function boxed(path: string, box: HTMLElement, context: Context): HTMLElement {
  const told = wordsOf(path, context.form);
  box.setAttribute("id", idOf(path));
  box.setAttribute("aria-describedby", sayId(path));
  if (context.readOnly) box.setAttribute("disabled", "");
  return h("div", { class: "field", "data-field": path }, h("label", { for: idOf(path) }, told.title ?? path), box,
    told.help ? h("small", { class: "soft" }, told.help) : null, h("small", { class: "says", id: sayId(path), role: "status" }));
}

export function field(holder: Values, name: string, path: string, raw: Schema, context: Context, usual?: number): HTMLElement {
  const { form } = context, schema = plain(raw, form), told = wordsOf(path, form), title = told.title ?? spoken(name);
  const about = [usual !== undefined && `Usually ${usual}.`, told.help, limits(schema) && `${limits(schema)}${told.unit && told.unit !== "rib" ? ` ${told.unit}` : ""}`].filter(Boolean).join(" ");
  return h("div", { class: "field", "data-field": path },
    h("label", { for: idOf(path) }, title), h("span", { class: "value" }, input(holder, name, path, schema, context), told.unit && told.unit !== "rib" ? h("span", { class: "unit" }, told.unit) : null),
    about ? h("small", { class: "soft" }, about) : null, h("small", { class: "says", id: sayId(path), role: "status" }));
}

/** Whether a value is one that a single field can hold. */
export const isSimple = (schema: Schema): boolean => schema.enum !== undefined || ["string", "number", "integer"].includes(schema.type ?? "");
