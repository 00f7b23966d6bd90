// The frame around all rooms: where one is, what went wrong, what can be taken back.
import { button, h, need } from "../../shared/dom";
import { words } from "../../shared/net";

export interface Room { element: HTMLElement; leave?: () => void }
export const go = (place: string): void => { location.hash = place; };
export const link = (text: string, place: string, given: Record<string, string> = {}): HTMLAnchorElement => h("a", { href: `#${place}`, ...given }, text);

export function problem(error: unknown): void {
  const text = error ? words(error) : "";
  const box = need("problem");
  if (!text) leave(box);
  box.hidden = !text;
  box.replaceChildren(text, ...(text ? [button("Close", () => problem(""), { class: "quiet" })] : []));
}

/** The focus to a room's title, from where Tab goes on. */
export function reach(title: HTMLElement | null): void {
  const at = title ?? need("room");
  at.tabIndex = -1;
  at.focus();
}

/** What is about to go hands the focus to the room. */
function leave(box: HTMLElement): void {
  if (box.contains(document.activeElement)) reach(need("room").querySelector("h1"));
}

const REACHED = "a[href], button:enabled, input:enabled, select:enabled, textarea:enabled, summary";
const wordsOn = (element: Element): string => element.getAttribute("aria-label") ?? element.textContent ?? "";

/** Draw a place anew. The focus goes to what has its id or its words again, else to what is around that. */
export function anew(place: HTMLElement, draw: () => void): void {
  const had = document.activeElement, around: string[] = [];
  if (!had || !place.contains(had)) return draw();
  for (let at: Element | null = had.parentElement; at && at !== place; at = at.parentElement) if (at.id) around.push(at.id);
  draw();
  const outer = [...around.map((id) => document.getElementById(id)).filter((one) => one !== null), place];
  const same = had.id ? document.getElementById(had.id) : [...(outer[0] ?? place).querySelectorAll(had.tagName)].find((one) => wordsOn(one) === wordsOn(had));
  place.tabIndex = -1;
  for (const one of [same, ...outer.map((one) => (one === place ? one : one.querySelector(REACHED)))]) {
    if (one instanceof HTMLElement) one.focus({ preventScroll: one === place });
    if (document.activeElement === one) return;
  }
}

/** What has been done, for a while, with the way to take it back; returns what ends this while. */
export function undoable(text: string, undo: () => Promise<void>): () => void {
  const box = need("undo"), close = (): void => { leave(box); box.hidden = true; };
  const back = button("Undo", () => {
    close();
    undo().catch(problem);
  });
  box.hidden = false;
  box.replaceChildren(text, back, button("Close", close, { class: "quiet" }));
  return () => { if (back.isConnected) close(); };
}

/** Do something that may fail; the button is off meanwhile. Nothing else having the focus then, the button has it again, or, if it is gone, the room. */
export function act(what: () => Promise<void>, by?: HTMLButtonElement): void {
  const had = by !== undefined && document.activeElement === by;
  problem("");
  if (by) by.disabled = true;
  what().catch(problem).finally(() => {
    if (by) by.disabled = false;
    if (!had || (document.activeElement && document.activeElement !== document.body)) return;
    if (by.isConnected) by.focus({ preventScroll: true }); else reach(need("room").querySelector("h1"));
  });
}

export const state = { readOnly: false, uploadBytes: 0 };

/** A push by its id; one that says what it is, as "push-1", stands alone. As the server says it (`words.py`). */
export const pushNamed = (id: string): string => (/^push(?![a-z])/i.test(id) ? id : `push ${id}`);
export const sentence = (text: string): string => text.slice(0, 1).toUpperCase() + text.slice(1);
export const when = (seconds: number | null): string => (seconds === null ? "" : new Date(1000 * seconds).toLocaleString([], { dateStyle: "medium", timeStyle: "short" }));
export function lasted(seconds: number): string {
  const whole = Math.max(0, Math.round(seconds));
  return whole < 60 ? `${whole} s` : `${Math.floor(whole / 60)} min ${String(whole % 60).padStart(2, "0")} s`;
}
export const number = (value: number): string => Number(value.toPrecision(3)).toLocaleString("en", { maximumSignificantDigits: 3 });

/** A question with two answers, by keyboard too. */
export async function sure(question: string, yes: string): Promise<boolean> {
  return new Promise((done) => {
    const dialog = h("dialog", { "aria-label": question });
    const end = (answer: boolean) => (): void => { dialog.close(); dialog.remove(); done(answer); };
    dialog.append(h("p", {}, question), h("div", { class: "row" }, button(yes, end(true), { class: "main" }), button("Cancel", end(false))));
    // Closed, it gives the focus back.
    dialog.addEventListener("cancel", end(false));
    document.body.append(dialog);
    dialog.showModal();
  });
}
