// All subjects: what is missing, the last run, what was found.
import { button, h } from "../../shared/dom";
import * as api from "./api";
import { act, anew, link, pushNamed, type Room, state, sure, undoable, when } from "./page";

const NEXT: Record<api.Card["stage"], [string, string]> = {
  broken: ["Look at it", "values"], form: ["Fill in the values", "values"], radiographs: ["Add radiographs", "radiographs"], annotate: ["Annotate", "annotate"],
  roles: ["See the steps", "run"], run: ["Run", "run"], done: ["See the result", "results"],
};
const JOBS: Record<api.Job["state"], string> = {
  waiting: "waits for its turn", running: "is running", done: "done", failed: "failed", cancelled: "cancelled", lost: "ended without a word",
};
export const jobWords = (job: api.Job): string => `${JOBS[job.state]} ${job.state === "running" || job.state === "waiting" ? "" : when(job.ended)}`.trim();

export function person(card: api.Card): string {
  const parts = [card.sex ?? "sex not known", card.age === null || card.age === undefined ? "age not known" : `${card.age} years`,
    card.height_cm ? `${card.height_cm} cm` : "height not known", card.pushes === 1 ? "1 push" : `${card.pushes ?? 0} pushes`];
  return card.stage === "broken" ? "" : parts.join(", ");
}

export function badge(card: api.Card): HTMLElement {
  const running = card.job && (card.job.state === "running" || card.job.state === "waiting");
  if (running) return h("span", { class: "badge", "data-kind": "run" }, card.job?.state === "running" ? "Running" : "Waiting");
  const result = card.result;
  if (card.stage === "done" && result && !result.problem) return h("span", { class: "badge", "data-kind": result.badge === "determined" ? "good" : result.badge === "doubtful" ? "bad" : "warn" }, result.badge);
  return h("span", { class: "badge", "data-kind": card.stage === "broken" ? "bad" : card.stage === "run" ? "good" : "open" }, card.stage_words);
}

export const nextOf = (card: api.Card): [string, string] => {
  const running = card.job && (card.job.state === "running" || card.job.state === "waiting");
  return running ? ["Watch", "run"] : NEXT[card.stage];
};

/** Where what comes next is done. */
export const placeOf = (card: api.Card): string => { const [, room] = nextOf(card); return room === "annotate" ? `/annotate/${card.key}/` : `#/subject/${card.key}/${room}`; };

function one(card: api.Card, again: () => void): HTMLElement {
  const [text, room] = nextOf(card), result = card.result;
  const missing = card.stage === "done" ? [] : card.missing;
  const lines = result && !result.problem ? h("ul", { class: "found" }, ...result.lines.map((line) => h("li", {}, line))) : null;
  const doubts = result?.doubts?.length ? h("p", { class: "bad" }, `To distrust: ${result.doubts[0]}`) : null;
  return h("article", { class: "card", id: `subject-${card.key}`, "aria-label": card.name },
    h("h2", {}, link(card.name, `/subject/${card.key}/${room === "annotate" ? "values" : room}`), badge(card)),
    h("p", { class: "soft" }, person(card)), lines, doubts,
    result && card.stale?.length ? h("p", { class: "warn" }, `Changed since this was found: ${card.stale.join(", ")}.`) : null,
    missing.length ? h("ul", { class: "missing" }, ...missing.slice(0, 3).map((line) => h("li", {}, line)), missing.length > 3 && h("li", {}, `and ${missing.length - 3} more`)) : null,
    card.job && card.job.ended ? h("p", { class: "soft" }, `Last run ${jobWords(card.job)}`) : null,
    h("div", { class: "row" }, h("a", { class: "button main", href: placeOf(card) }, text),
      state.readOnly ? null : button("Remove", () => act(async () => {
        const { trash } = await api.remove(card.key);
        again();
        undoable(`${card.name} was moved to the trash.`, async () => { await api.restore(trash); again(); });
      }), { "aria-label": `Remove ${card.name}` })));
}

export async function cards(): Promise<Room> {
  const list = h("div", { class: "cards" }), element = h("section", {}, h("h1", {}, "Subjects"), list);
  let timer = 0, over = false;
  const load = async (): Promise<void> => {
    const found = await api.subjects();
    anew(list, () => list.replaceChildren(...found.map((card) => one(card, () => void load()))));
    if (!found.length) list.append(h("div", { class: "card empty" }, h("p", {}, "There is no subject here yet."),
      h("p", { class: "soft" }, "A subject is made from the radiographs that a hospital exports: one frontal picture at rest, perhaps a lateral one, and the pictures of at least one push with its forces."),
      state.readOnly ? null : h("a", { class: "button main", href: "#/new" }, "New subject")));
    clearTimeout(timer);
    if (!over && found.some((card) => card.job?.state === "running" || card.job?.state === "waiting")) later();
  };
  // A server that does not answer once may do so later.
  const later = (): void => { timer = window.setTimeout(() => void load().catch(() => { if (!over) later(); }), 3000); };
  await load();
  return { element, leave: () => { over = true; clearTimeout(timer); } };
}

const titleOf = (one: api.Removed): string => (one.image ? `${one.name}: ${one.image.replace("rest/", "")} radiograph at rest` : one.push ? `${one.name}: ${pushNamed(one.push)}` : one.name);
function removedWords(one: api.Removed): string {
  const marked = one.vertebrae ? `${one.vertebrae} vertebrae are marked in it` : "Nothing is marked in it";
  if (one.image) return `Replaced ${when(one.removed)}. ${marked}. Put back, it takes the place of the present one, which comes here.`;
  return one.push ? `Removed ${when(one.removed)}. ${marked}. Its radiographs are in the subject’s folder still.` : `Removed ${when(one.removed)}`;
}
const lostWords = (one: api.Removed): string => (one.image ? "It and what was marked in it" : one.push ? "Its values and what was marked in it (its radiographs stay in the subject’s folder)" : "Radiographs, annotation and results");

export async function trashRoom(): Promise<Room> {
  const list = h("div", { class: "cards" });
  const load = async (): Promise<void> => {
    const found = await api.trash();
    anew(list, () => list.replaceChildren(...found.map((one) => h("article", { class: "card", "aria-label": titleOf(one) }, h("h2", {}, titleOf(one)), h("p", { class: "soft" }, removedWords(one)),
      state.readOnly ? null : h("div", { class: "row" }, button("Put back", () => act(async () => { await api.restore(one.key); await load(); }), { class: "main" }),
        button("Delete for good", () => act(async () => {
          if (!(await sure(`Delete ${titleOf(one)} for good? ${lostWords(one)} can't be brought back.`, "Delete"))) return;
          await api.deleteForGood(one.key);
          await load();
        })))))));
    if (!found.length) list.append(h("p", { class: "soft" }, "The trash is empty."));
  };
  await load();
  return { element: h("section", {}, h("h1", {}, "Trash"), h("p", { class: "soft" }, "Subjects and pushes that were removed, and radiographs at rest that were replaced, stay here until somebody deletes them for good."), list) };
}
