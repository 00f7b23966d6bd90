// Which stiffness ratios are estimated: the usual ones, or a row for each, of what and where.
import { button, h } from "../../shared/dom";
import type { Values } from "./api";
import { type Context, sayId, wordsOf } from "./fields";

const USUAL = ["lateral_bending", "tissue"], AT = "@", BETWEEN = "between";
type Make = (change: () => void) => void;

export function ratios(values: Values, context: Context, now: Make): HTMLElement {
  const { form } = context, { groups, parts, chain } = form.choices, told = wordsOf("parameters", form);
  const names = values["parameters"] as string[] | null | undefined;
  const titleOf = (name: string): string => groups.find((one) => one.name === name)?.title ?? name;
  const set = (i: number, name: string, focus: string): void => {
    now(() => { (names as string[])[i] = name; });
    document.getElementById(focus)?.focus();
  };
  const select = (id: string, label: string, options: [string, string][], value: string, changed: (value: string) => void): HTMLSelectElement => {
    // What no list has, as a row of Table 1 that somebody wrote into the file, stays as it is.
    const all = options.some(([name]) => name === value) ? options : [...options, [value, value] as [string, string]];
    const box = h("select", { id, "aria-label": label, "aria-describedby": sayId("parameters"), disabled: context.readOnly }, ...all.map(([name, title]) => h("option", { value: name }, title)));
    box.value = value;
    box.addEventListener("change", () => changed(box.value));
    return box;
  };
  const row = (name: string, i: number): HTMLElement => {
    const [stem = "", part = ""] = name.split(AT), of = groups.find((one) => one.name === stem)?.of ?? "joints", id = `ratio-${i}`;
    const pair = of === "joints" && part.includes("-") ? part.split("-") : null;
    const named = (next: string): string => (next ? `${stem}${AT}${next}` : stem), places: [string, string][] = (parts[of] ?? []).map((one) => [one.name, one.title]);
    if (of === "joints") places.push([BETWEEN, "between two vertebrae"]);
    const end = (k: 0 | 1): HTMLElement => select(`${id}-${k}`, `Ratio ${i + 1}, ${k ? "lower" : "upper"} vertebra`, (k ? chain.slice(1) : chain.slice(0, -1)).map((one) => [one, one]), pair?.[k] ?? "",
      (chosen) => set(i, named((k ? [pair?.[0], chosen] : [chosen, pair?.[1]]).join("-")), `${id}-${k}`));
    return h("li", {}, h("div", { class: "row" },
      select(`${id}-of`, `Ratio ${i + 1}, of what`, groups.map((one) => [one.name, one.title]), stem, (next) => {
        const same = (groups.find((one) => one.name === next)?.of ?? "joints") === of;
        set(i, same && part ? `${next}${AT}${part}` : next, `${id}-of`);
      }),
      select(`${id}-at`, `Ratio ${i + 1}, where`, places, pair ? BETWEEN : part, (next) => set(i, named(next === BETWEEN ? "T8-T9" : next), `${id}-at`)),
      pair ? h("span", {}, end(0), " to ", end(1)) : null,
      context.readOnly || (names ?? []).length < 2 ? null : button("Take out", () => now(() => { (names as string[]).splice(i, 1); }), { "aria-label": `Take out: ratio ${i + 1}` })));
  };
  const says = h("p", { class: "says", id: sayId("parameters"), role: "status" });
  if (!names) {
    return h("div", { id: "ratios" }, h("h2", {}, told.title ?? "parameters"), h("p", {}, `As usual: ${USUAL.map(titleOf).join("; ")}.`), says,
      context.readOnly ? null : button("Choose others", () => now(() => { values["parameters"] = [...USUAL]; }), { id: "ratios-choose" }));
  }
  return h("div", { id: "ratios" }, h("h2", {}, told.title ?? "parameters"), h("p", { class: "soft" }, told.help ?? ""), says, h("ol", {}, ...names.map(row)),
    context.readOnly ? null : h("p", { class: "row" },
      button("Add a ratio", () => now(() => { names.push(groups.map((one) => one.name).find((one) => !names.includes(one)) ?? "lateral_bending"); }), { id: "ratios-add" }),
      button("The usual ones again", () => now(() => { delete values["parameters"]; }), { id: "ratios-usual" })));
}
