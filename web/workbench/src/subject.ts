// One subject: its rooms in the order of the work, each with how far it is.
import { h } from "../../shared/dom";
import * as api from "./api";
import { badge, person } from "./cards";
import { values } from "./form";
import { problem, type Room } from "./page";
import { results } from "./results";
import { run } from "./run";

const ROOMS: [string, string][] = [["values", "Values"], ["annotate", "Annotation"], ["run", "Run"], ["results", "Results"]];
const ORDER: api.Card["stage"][] = ["broken", "form", "radiographs", "annotate", "roles", "run", "done"];

export async function subject(key: string, room: string): Promise<Room> {
  let card = await api.subject(key);
  const head = h("div", { class: "subject" }), missing = h("div");
  const draw = (): void => {
    const done: Record<string, boolean> = { values: ORDER.indexOf(card.stage) > 1, annotate: ORDER.indexOf(card.stage) > 3, run: card.stage === "done", results: card.stage === "done" };
    head.replaceChildren(h("h1", {}, card.name, " ", badge(card)), h("p", { class: "soft" }, person(card)),
      h("nav", { class: "way", "aria-label": "Steps of the work" }, ...ROOMS.map(([name, title], i) => h("a", { href: name === "annotate" ? `/annotate/${key}/` : `#/subject/${key}/${name}`, ...(name === room ? { "aria-current": "page" } : {}), "data-done": String(done[name]) },
        h("span", { class: "dot", "aria-hidden": "true" }, done[name] ? "✓" : String(i + 1)), title, done[name] ? h("span", { class: "hidden" }, " (done)") : null))));
    missing.replaceChildren(card.missing.length && room !== "values" ? h("details", { class: "warn" }, h("summary", {}, `Still missing: ${card.missing.length}`), h("ul", {}, ...card.missing.map((line) => h("li", {}, line)))) : "");
  };
  draw();
  const inner = room === "results" ? await results(key, card) : room === "run" ? await run(key, card.stage) : card.stage === "broken" ? { element: h("p", { class: "bad" }, card.missing.join(" ")) } : await values(key);
  const changed = (): void => { void api.subject(key).then((found) => { card = found; draw(); }, problem); };
  document.addEventListener("subject-changed", changed);
  return {
    element: h("section", { class: room === "results" ? "wide" : "" }, head, missing, inner.element),
    leave: () => { document.removeEventListener("subject-changed", changed); (inner as Room).leave?.(); },
  };
}
