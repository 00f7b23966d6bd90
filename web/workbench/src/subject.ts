// One subject: its rooms in the order of the work, each with how far it is.
import { h } from "../../shared/dom";
import * as api from "./api";
import { badge, nextOf, person, placeOf } from "./cards";
import { values } from "./form";
import { problem, type Room } from "./page";
import { radiographs } from "./radiographs";
import { results } from "./results";
import { run } from "./run";

const ROOMS: [string, string][] = [["radiographs", "Radiographs"], ["values", "Values"], ["annotate", "Annotation"], ["run", "Run"], ["results", "Results"]];
const ORDER: api.Card["stage"][] = ["broken", "form", "radiographs", "annotate", "roles", "run", "done"];

export async function subject(key: string, room: string): Promise<Room> {
  let card = await api.subject(key);
  const missing = h("div"), name = h("h1"), who = h("p", { class: "soft" }), next = h("a", { class: "button main", id: "next" });
  // Made once: a link that is replaced while it is pressed or has the focus takes the click or the focus with it.
  const steps = ROOMS.map(([one, title], i) => {
    const dot = h("span", { class: "dot", "aria-hidden": "true" }), told = h("span", { class: "hidden" });
    const made = h("a", { href: one === "annotate" ? `/annotate/${key}/` : `#/subject/${key}/${one}`, ...(one === room ? { "aria-current": "page" } : {}) }, dot, title, told);
    return { made, show: (done: boolean): void => { made.dataset["done"] = String(done); dot.textContent = done ? "✓" : String(i + 1); told.textContent = done ? " (done)" : ""; } };
  });
  const head = h("div", { class: "subject" }, name, who, h("nav", { class: "way", "aria-label": "Steps of the work" }, ...steps.map(({ made }) => made)));
  const draw = (): void => {
    const far = ORDER.indexOf(card.stage);
    const radiographs = card.stage !== "broken" && !card.missing.some((line) => line.endsWith(": no radiograph"));
    const done: Record<string, boolean> = { radiographs, values: far > 1, annotate: far > 3, run: card.stage === "done", results: card.stage === "done" };
    name.replaceChildren(card.name, " ", badge(card));
    who.textContent = person(card);
    const [text, place] = nextOf(card);
    next.textContent = text;
    next.href = placeOf(card);
    next.hidden = place === room;
    steps.forEach(({ show }, i) => show(done[ROOMS[i]?.[0] ?? ""] ?? false));
    missing.replaceChildren(card.missing.length && room !== "values" ? h("details", { class: "warn" }, h("summary", {}, `Still missing: ${card.missing.length}`), h("ul", {}, ...card.missing.map((line) => h("li", {}, line)))) : "");
  };
  draw();
  const inner = room === "results" ? await results(key, card) : room === "run" ? await run(key, card.stage) : room === "radiographs" && card.stage !== "broken" ? await radiographs(key) : card.stage === "broken" ? { element: h("p", { class: "bad" }, card.missing.join(" ")) } : await values(key, next);
  let turn = 0;
  const changed = (): void => {
    const mine = ++turn;
    void api.subject(key).then((found) => { if (mine === turn) { card = found; draw(); } }, problem);
  };
  document.addEventListener("subject-changed", changed);
  return {
    element: h("section", { class: room === "results" ? "wide" : "" }, head, missing, inner.element),
    leave: () => { document.removeEventListener("subject-changed", changed); (inner as Room).leave?.(); },
  };
}
