// Stiffness of one or several subjects on a common scale, each value with its 95 % interval.
import { h, svg } from "../../shared/dom";
import type { Result, Stiffness } from "./api";
import { number } from "./page";

/** A value and its interval with the digits and open ends that the report gives them. */
export const told = (one: Stiffness): string => `${one.words}${one.interval ? ` (${one.interval})` : ""}`;
export const span = (low: number | null, high: number | null): string => (low === null && high === null ? "" : `${low === null ? "?" : number(low)} to ${high === null ? "?" : number(high)}`);

/** What may stand on one scale: a ratio to the whole is another than one to the default. */
export const kind = (one: Stiffness): string => `${one.name}, ${one.unit}`;

export function bars(subjects: { name: string; result: Result }[]): HTMLElement {
  const kinds = [...new Set(subjects.flatMap(({ result }) => result.stiffness.map(kind)))];
  return h("div", { class: "bars" }, ...kinds.map((its) => {
    const rows = subjects.flatMap((one) => one.result.stiffness.filter((found) => kind(found) === its).map((found) => ({ who: one.name, ...found })));
    const ends = rows.flatMap((row) => [row.value, row.low ?? row.value, row.high ?? row.value]).filter((value) => value > 0), unit = rows[0]?.unit ?? "";
    const [least, most] = [Math.log(Math.min(...ends) / 1.3), Math.log(Math.max(...ends) * 1.3)], [width, left] = [420, 8];
    const x = (value: number): number => left + ((width - 2 * left) * (Math.log(Math.max(value, 1e-9)) - least)) / (most - least);
    return h("figure", {}, h("figcaption", {}, `${rows[0]?.title ?? its}, ${unit}`), ...rows.map((row) => h("div", { class: "bar-row" }, subjects.length > 1 ? h("span", {}, row.who) : null,
      svg("svg", { viewBox: `0 0 ${width} 26`, role: "img", "aria-label": `${row.who}: ${row.words} ${unit}, 95 % ${row.interval}` },
        svg("path", { class: "axis", d: `M${left} 13H${width - left}` }),
        // An open end has no stop.
        row.low !== null && row.high !== null && svg("path", { class: "interval", d: `M${x(row.low)} 13H${x(row.high)}${row.open_low ? "" : `M${x(row.low)} 7v12`}${row.open_high ? "" : `M${x(row.high)} 7v12`}` }),
        svg("circle", { cx: x(row.value), cy: 13, r: 5.5 })),
      h("span", { class: "figure" }, h("b", {}, row.words), row.interval ? ` (${row.interval})` : "", row.determined === "determined" || !row.determined ? "" : h("small", { class: "soft" }, ` ${row.determined}`)))));
  }));
}
