// The frame around all rooms: where one is, what went wrong, what can be taken back.
import { button, h, need } from "../../shared/dom";
import { words } from "../../shared/net";

export interface Room { element: HTMLElement; leave?: () => void }
export const go = (place: string): void => { location.hash = place; };
export const link = (text: string, place: string, given: Record<string, string> = {}): HTMLAnchorElement => h("a", { href: `#${place}`, ...given }, text);

export function problem(error: unknown): void {
  const text = error ? words(error) : "";
  const box = need("problem");
  box.hidden = !text;
  box.replaceChildren(text, ...(text ? [button("Close", () => problem(""), { class: "quiet" })] : []));
}

/** What has been done, for a while, with the way to take it back; returns what ends this while. */
export function undoable(text: string, undo: () => Promise<void>): () => void {
  const box = need("undo"), back = button("Undo", () => {
    box.hidden = true;
    undo().catch(problem);
  });
  box.hidden = false;
  box.replaceChildren(text, back, button("Close", () => { box.hidden = true; }, { class: "quiet" }));
  return () => { if (back.isConnected) box.hidden = true; };
}

/** Do something that may fail; the button is off meanwhile. */
export function act(what: () => Promise<void>, by?: HTMLButtonElement): void {
  problem("");
  if (by) by.disabled = true;
  what().catch(problem).finally(() => { if (by) by.disabled = false; });
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
    dialog.addEventListener("cancel", () => { dialog.remove(); done(false); });
    document.body.append(dialog);
    dialog.showModal();
  });
}
