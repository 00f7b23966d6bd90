// Two subjects or visits side by side, and all of them in a table.
import { button, h } from "../../shared/dom";
import * as api from "./api";
import { badge, person } from "./cards";
import { act, link, number, type Room } from "./page";
import { bars, kind, span, told } from "./stiffness";

export async function compare(first = "", second = ""): Promise<Room> {
  const cards = (await api.subjects()).filter((card) => card.result && !card.result.problem), below = h("div");
  const select = (id: string, label: string, value: string): [HTMLElement, HTMLSelectElement] => {
    const made = h("select", { id }, ...cards.map((card) => h("option", { value: card.key }, card.name)));
    if (cards.some((card) => card.key === value)) made.value = value;
    made.addEventListener("change", () => act(draw));
    return [h("label", {}, `${label} `, made), made];
  };
  const [a, left] = select("first", "First", first), [b, right] = select("second", "Second", second || (cards[1]?.key ?? ""));
  let turn = 0;
  async function draw(): Promise<void> {
    const mine = ++turn;
    below.replaceChildren();
    const pair = [left.value, right.value].map((key) => cards.find((card) => card.key === key)).filter((card) => card !== undefined);
    const [one, other] = pair, visits = one && other && one.key !== other.key && one.id === other.id ? await api.visits(one.key, other.key) : null;
    const tickets = await Promise.all(pair.map((card) => api.results(card.key)));
    // Others were chosen meanwhile.
    if (mine !== turn) return;
    below.replaceChildren(
      visits?.same ? change(visits) : "",
      h("div", { class: "card" }, h("h2", {}, "Stiffness, 95 % intervals"), bars(pair.map((card) => ({ name: card.name, result: card.result as api.Result }))),
        h("p", { class: "soft" }, `Values whose intervals overlap widely may be the same.${visits?.same ? "" : " Two visits of one person have the same name of the subject in their values; whether the person changed is said here then."}`)),
      h("div", { class: "pair" }, ...pair.map((card, i) => h("section", { "aria-label": card.name }, h("h2", {}, card.name, " ", badge(card)), h("p", { class: "soft" }, person(card)),
        tickets[i]?.pages.some((page) => page.name === "report.html") ? h("iframe", { src: `/shown/${tickets[i].ticket}/report.html`, title: `Report of ${card.name}`, sandbox: "allow-scripts" }) : null))));
  }
  if (cards.length < 2) return { element: h("section", {}, h("h1", {}, "Compare"), h("p", { class: "soft" }, "Two subjects with a result are needed.")) };
  await draw();
  return { element: h("section", { class: "wide" }, h("h1", {}, "Compare"), h("p", { class: "row" }, a, b), below) };
}

const KEPT_MS = 60_000;
/** Of two visits of one person: whether somebody changed, how estimates scatter, and the smallest change that would show. */
function change(of: api.Visits): HTMLElement {
  const title = h("h2", {}, "One person, two visits");
  if (of.problem) return h("div", { class: "card", id: "change" }, title, h("p", { class: "warn" }, `Whether this person changed can’t be told: ${of.problem}`));
  const rows = of.changes.map((one) => {
    const scatter = of.scatter[one.name];
    return h("tr", {}, h("th", { scope: "row" }, one.title), h("td", {}, h("b", {}, one.verdict)), h("td", {}, `${number(one.factor)} (${span(one.low, one.high)})`), h("td", {}, `a factor of ${number(one.detectable_factor)}`),
      h("td", {}, scatter ? `${number(scatter.within_sd_log)} (${span(scatter.low, scatter.high)}); expected ${number(scatter.expected_sd_log)}` : "not known"));
  });
  return h("div", { class: "card", id: "change" }, title, h("p", { class: "soft" }, "“First” is taken for the earlier visit."),
    h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Change between the visits" }, h("table", {}, h("thead", {}, h("tr", {}, ...["Ratio", "Changed?", "Second over first, 95 %", "Would not show below", "Scatter within the person, sd of the log"].map((one) => h("th", { scope: "col" }, one)))), h("tbody", {}, ...rows))),
    h("ul", {}, ...of.lines.map((line) => h("li", {}, line))));
}

type Column = [string, (card: api.Card) => string | number | null, ((card: api.Card) => string)?];

export async function table(): Promise<Room> {
  const cards = await api.subjects(), kinds = [...new Set(cards.flatMap((card) => card.result?.stiffness?.map(kind) ?? []))];
  const columns: Column[] = [
    ["Subject", (card) => card.name], ["State", (card) => (card.stage === "done" ? (card.result?.badge ?? "") : card.result && card.stale?.length ? `${card.stage_words}; the result is older` : card.stage_words)], ["Sex", (card) => card.sex ?? null],
    ["Age, years", (card) => card.age ?? null], ["Height, cm", (card) => card.height_cm ?? null], ["Pushes", (card) => card.pushes ?? null],
    ...kinds.map((its): Column => {
      const of = (card: api.Card): api.Stiffness | undefined => card.result?.stiffness?.find((one) => kind(one) === its);
      const first = cards.map(of).find((one) => one);
      return [`${first?.title ?? its}, ${first?.unit ?? ""}`, (card) => of(card)?.value ?? null, (card) => { const one = of(card); return one ? told(one) : ""; }];
    }),
    ["Change of the Cobb angle", (card) => card.result?.cobb?.change_deg ?? null, (card) => card.result?.cobb?.words ?? ""],
  ];
  let by = 0, up = true;
  const head = h("tr"), body = h("tbody");
  const draw = (): void => {
    head.replaceChildren(...columns.map(([title], i) => h("th", { scope: "col", "aria-sort": i === by ? (up ? "ascending" : "descending") : "none" },
      h("button", { type: "button", class: "quiet", onclick: () => { up = i === by ? !up : true; by = i; draw(); head.querySelectorAll("button")[i]?.focus(); } }, title, i === by ? (up ? " ▲" : " ▼") : ""))));
    const value = (columns[by] as Column)[1];
    const sorted = [...cards].sort((one, other) => {
      const [p, q] = [value(one), value(other)];
      if (p === null || q === null) return p === q ? 0 : p === null ? 1 : -1;
      return (up ? 1 : -1) * (typeof p === "number" && typeof q === "number" ? p - q : String(p).localeCompare(String(q)));
    });
    body.replaceChildren(...sorted.map((card) => h("tr", {}, ...columns.map(([, of, shown], i) => (i ? h("td", {}, shown ? shown(card) : String(of(card) ?? "")) : h("th", { scope: "row" }, link(card.name, `/subject/${card.key}/results`)))))));
  };
  const csv = button("Download CSV", () => act(async () => {
    const address = URL.createObjectURL(new Blob([await api.table()], { type: "text/csv" })), given = h("a", { href: address, download: "subjects.csv" });
    document.body.append(given);
    given.click();
    given.remove();
    setTimeout(() => URL.revokeObjectURL(address), KEPT_MS);
  }, csv), { id: "table-csv" });
  draw();
  return { element: h("section", { class: "wide" }, h("h1", {}, "All subjects"), cards.length ? h("p", { class: "row" }, csv) : null, h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "All subjects" }, h("table", {}, h("thead", {}, head), body)), h("p", { class: "soft" }, "Values with 95 % intervals; the change of the Cobb angle is the one measured under the largest force, ± half its interval. For statistics over people see spinestiff cohort.")) };
}
