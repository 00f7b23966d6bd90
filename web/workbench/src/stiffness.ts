// Stiffness of one or several subjects on a common scale, each value with its 95 % interval.
import { h, svg } from "../../shared/dom";
import type { Result } from "./api";
import { number } from "./page";

const TITLES: Record<string, string> = {
  lateral_bending_thoracic: "Lateral bending of a thoracic level", lateral_bending_lumbar: "Lateral bending of a lumbar level", tissue_young: "Young’s modulus of the soft tissue",
};
export const titleOf = (name: string): string => TITLES[name] ?? name.replaceAll("_", " ");
export const span = (low: number | null, high: number | null): string => (low === null && high === null ? "" : `${low === null ? "?" : number(low)} to ${high === null ? "?" : number(high)}`);

export function bars(subjects: { name: string; result: Result }[]): HTMLElement {
  const names = [...new Set(subjects.flatMap(({ result }) => result.stiffness.map((one) => one.name)))];
  return h("div", { class: "bars" }, ...names.map((name) => {
    const rows = subjects.flatMap((one) => one.result.stiffness.filter((found) => found.name === name).map((found) => ({ who: one.name, ...found })));
    const ends = rows.flatMap((row) => [row.value, row.low ?? row.value, row.high ?? row.value]).filter((value) => value > 0), unit = rows[0]?.unit ?? "";
    const [least, most] = [Math.log(Math.min(...ends) / 1.3), Math.log(Math.max(...ends) * 1.3)], [width, left] = [420, 8];
    const x = (value: number): number => left + ((width - 2 * left) * (Math.log(Math.max(value, 1e-9)) - least)) / (most - least);
    return h("figure", {}, h("figcaption", {}, `${titleOf(name)}, ${unit}`), ...rows.map((row) => h("div", { class: "bar-row" }, subjects.length > 1 ? h("span", {}, row.who) : null,
      svg("svg", { viewBox: `0 0 ${width} 26`, role: "img", "aria-label": `${row.who}: ${number(row.value)} ${unit}, 95 % ${span(row.low, row.high)}` },
        svg("path", { class: "axis", d: `M${left} 13H${width - left}` }),
        row.low !== null && row.high !== null && svg("path", { class: "interval", d: `M${x(row.low)} 13H${x(row.high)}M${x(row.low)} 7v12M${x(row.high)} 7v12` }),
        svg("circle", { cx: x(row.value), cy: 13, r: 5.5 })),
      h("span", { class: "figure" }, h("b", {}, number(row.value)), ` (${span(row.low, row.high)})`, row.determined === "determined" || !row.determined ? "" : h("small", { class: "soft" }, ` ${row.determined}`)))));
  }));
}
