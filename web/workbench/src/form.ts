// The values of a subject: a form from its schema, checked as one types and saved as soon as it may be.
import { button, h, need } from "../../shared/dom";
import { Refused, words } from "../../shared/net";
import * as api from "./api";
import { apart } from "./apart";
import { beam } from "./beam";
import { markers, views } from "./beside";
import { skin, trunk } from "./body";
import { type Context, field, input, isSimple, plain, sayId, typed, wordsOf } from "./fields";
import { gaugeLog } from "./gauge";
import { act, anew, problem, pushNamed, type Room, sentence, state, undoable } from "./page";
import { ratios } from "./ratios";
import { scales } from "./scale";
import { type Push, torso } from "./torso";

// From BAD_GATEWAY on, what stands between page and server has answered in its place.
const PAUSE_MS = 350, RETRY_MS = 2500, BAD_GATEWAY = 502, BY_HAND = new Set(["schema_version", "pushes", "xray", "priors", "trunk", "skin_scan", "parameters", "population", "id", "age", "sex", "height_cm", "mass_kg"]);
const PUSH = ["side", "level", "d21_mm", "d31_mm"], PERSON = ["id", "age", "sex", "height_cm", "mass_kg"];

/** Whether two values are the same, whatever the order of their names. */
const same = (one: unknown, other: unknown): boolean => JSON.stringify(one, sorted) === JSON.stringify(other, sorted);
const sorted = (_: string, value: unknown): unknown => (value && typeof value === "object" && !Array.isArray(value) ? Object.fromEntries(Object.entries(value).sort(([one], [other]) => (one < other ? -1 : 1))) : value);

/** `next` leads on to what comes after the values; it stays in sight with what is said of them. */
export async function values(key: string, next: HTMLElement): Promise<Room> {
  let form = await api.form(key), timer = 0, saved = JSON.stringify(form.values), stopped = state.readOnly, over = false, writing: Promise<void> = Promise.resolve();
  /** Values that were sent without an answer, so that they may be saved or not; sent again before any newer ones. */
  let unanswered: string | null = null;
  // Values as they were, or how to take back what is no value.
  const past: (string | (() => Promise<void>))[] = [], body = h("div"), said = h("p", { role: "status", class: "saved" });
  const undo = button("↶ Undo", () => act(async () => {
    // What is being saved belongs to what can be taken back.
    await writing.catch(() => undefined);
    const before = past.pop();
    if (!before) return;
    if (typeof before !== "string") return before();
    form.values = JSON.parse(before) as api.Values;
    draw();
    await save(true);
  }), { id: "undo-values", "aria-keyshortcuts": "Control+Z" });
  const context = (): Context => ({ form, readOnly: state.readOnly, changed: later, focused: (path) => pictures(path) });
  let focus = "";

  function later(): void {
    pictures(focus);
    if (stopped) return;
    tell("saving", "Checking …");
    soon(PAUSE_MS);
  }
  function soon(wait: number): void {
    clearTimeout(timer);
    timer = window.setTimeout(() => void save().catch((error: unknown) => {
      tell("failed", `Not saved: ${words(error)} `);
      if (error instanceof Refused && error.status === 409) said.append(button("Load what is there now", () => act(reload), { id: "reload-values" }));
      if (!answered(error) && !over) soon(RETRY_MS);
    }), wait);
  }
  function answered(error: unknown): boolean { return error instanceof Refused && error.status < BAD_GATEWAY; }
  function tell(kind: string, text: string): void { said.dataset["state"] = kind; said.textContent = text; }

  /** One after the other: each is made on the revision that the one before has left. */
  function save(undone = false): Promise<void> { return (writing = writing.catch(() => undefined).then(() => write(undone))); }
  async function write(undone: boolean): Promise<void> {
    const text = JSON.stringify(form.values), judged = await api.check(form.values);
    if (text !== JSON.stringify(form.values)) return;
    judge(judged);
    if (judged.problems.length) return tell("failed", `Not saved: ${judged.problems.length === 1 ? "one value is not possible" : `${judged.problems.length} values are not possible`}.`);
    if (unanswered !== null) await put(unanswered, undone);
    if (text !== saved) await put(text, undone);
    undo.disabled = !past.length;
    // What was typed meanwhile is said to be saved once it is.
    if (text === JSON.stringify(form.values)) tell("saved", judged.open.length ? `Saved. ${judged.open.length === 1 ? "One value is" : `${judged.open.length} values are`} still to be filled in.` : "Saved. Everything is filled in.");
    if (!over) document.dispatchEvent(new Event("subject-changed"));
  }

  async function put(text: string, undone: boolean): Promise<void> {
    try {
      form.revision = (await api.save(key, JSON.parse(text) as api.Values, form.revision)).revision;
    } catch (error) {
      unanswered = answered(error) ? null : text;
      if (error instanceof Refused && error.status === 403) stopped = true;
      throw error;
    }
    unanswered = null;
    if (!undone) past.push(saved);
    saved = text;
  }

  function judge({ problems, open }: api.Judged): void {
    for (const place of body.querySelectorAll<HTMLElement>(".says")) { place.textContent = ""; delete place.dataset["kind"]; }
    for (const box of body.querySelectorAll("[aria-invalid]")) box.removeAttribute("aria-invalid");
    const put = (path: string, text: string, kind: string): void => {
      // The body may not be on the page yet.
      const at = (where: string): HTMLElement | null => body.querySelector(`#${sayId(where)}`);
      let where = path.replace(/\[(\d+) to \d+\]$/, "[$1]"), place = at(where);
      // A list's entry, then what it is part of.
      while (!place && where) place = at((where = where.slice(0, Math.max(0, where.lastIndexOf("."), where.lastIndexOf("[")))));
      place ??= body.querySelector<HTMLElement>("#values-says");
      if (!place) return;
      place.append(place.textContent ? " " : "", text);
      place.dataset["kind"] = kind;
      if (kind === "bad") for (const box of body.querySelectorAll(`[aria-describedby="${place.id}"]`)) box.setAttribute("aria-invalid", "true");
    };
    for (const { field: path, text } of problems) put(path, text, "bad");
    for (const { field: path } of open) put(path, "Not known yet.", "open");
  }

  function draw(): void {
    const schema = form.schema, told = (name: string): api.Schema => schema.properties?.[name] ?? {};
    const pushes = (form.values["pushes"] ?? []) as api.Values[];
    const others = Object.keys(schema.properties ?? {}).filter((name) => !BY_HAND.has(name));
    const simple = others.filter((name) => name !== "torso" && isSimple(plain(told(name), form))), kept = others.filter((name) => !simple.includes(name) && form.values[name] !== undefined);
    anew(body, () => body.replaceChildren(
      h("p", { id: "values-says", class: "says", role: "alert" }),
      h("fieldset", {}, h("legend", {}, "Person"), h("div", { class: "grid" }, ...PERSON.map((name) => field(form.values, name, name, told(name), context())))),
      ...pushes.map((push, number) => pushSet(push, number, plain(plain(told("pushes"), form).items ?? {}, form))),
      pushes.length ? "" : h("p", { class: "warn" }, "There is no push yet: a plan can be made, and no estimate."),
      trunk(form.values, context(), now), state.readOnly && !form.values["skin_scan"] ? "" : skin(key, form.values, context(), now, reload),
      h("details", { id: "xray", ...(xrayOpen() ? { open: true } : {}) }, h("summary", {}, wordsOf("xray", form).title ?? "xray"), h("p", { class: "soft" }, wordsOf("xray", form).help ?? ""), xray(plain(told("xray"), form))),
      h("details", { id: "choices", ...(form.values["parameters"] || form.values["population"] ? { open: true } : {}) }, h("summary", {}, "Choices of the model"), h("p", { class: "soft" }, "The usual ones fit most subjects."),
        h("div", { class: "grid" }, ...simple.map((name) => field(form.values, name, name, told(name), context())),
          field(form.values, "population", "population", { enum: form.choices.populations, default: "nobody’s" }, chosen())),
        ratios(form.values, context(), now),
        kept.length ? h("p", { class: "soft" }, `Kept as they are in subject.json: ${kept.join(", ")}.`) : null), priors()));
    judge(form);
    pictures(focus);
  }

  /** Where nothing chosen is as good as nothing there. */
  function chosen(): Context {
    return { ...context(), changed: () => { if (form.values["population"] === null) delete form.values["population"]; later(); } };
  }

  function priors(): HTMLElement {
    const holder = (form.values["priors"] ?? {}) as api.Values, told = wordsOf("priors", form);
    const own = { ...context(), changed: () => {
      for (const [name, value] of Object.entries(holder)) if (value === null) delete holder[name];
      if (Object.keys(holder).length) form.values["priors"] = holder; else delete form.values["priors"];
      later();
    } };
    return h("details", { id: "priors", ...(Object.keys(holder).length ? { open: true } : {}) }, h("summary", {}, told.title ?? "priors"), h("p", { class: "soft" }, `${told.help ?? ""} Empty: the usual one. Whoever measured better, or knows of worse, says so here.`),
      h("p", { class: "says", id: sayId("priors"), role: "status" }),
      h("div", { class: "grid" }, ...Object.entries(form.priors).map(([name, usual]) => field(holder, name, `priors.${name}`, { type: "number", minimum: 0, maximum: 1000 }, own, usual))));
  }

  const xrayOpen = (): boolean => body.querySelector<HTMLDetailsElement>("#xray")?.open ?? ["scale", "images"].some((name) => (form.values["xray"] as api.Values | undefined)?.[name]);

  function xray(schema: api.Schema): HTMLElement {
    const holder = (form.values["xray"] ?? {}) as api.Values, keep = (): void => { if (Object.keys(holder).length) form.values["xray"] = holder; };
    const own = { ...context(), changed: () => { keep(); later(); } }, pushes = (form.values["pushes"] ?? []) as api.Values[];
    return h("div", {}, h("div", { class: "beside" }, h("div", { class: "grid" }, ...Object.entries(schema.properties ?? {}).filter(([, one]) => isSimple(plain(one, form))).map(([name, one]) => field(holder, name, `xray.${name}`, one, own))),
      h("figure", { class: "diagram" })), apart(holder, pushes, context(), now, keep), scales(key, holder, pushes, context(), now, keep));
  }

  function pushSet(push: api.Values, number: number, schema: api.Schema): HTMLElement {
    const path = `pushes[${number}]`, forces = (push["forces_n"] ?? []) as unknown[], told = schema.properties ?? {};
    const roles = (push["roles"] ?? forces.map(() => "unused")) as unknown[];
    const rolesOf = plain(told["roles"] ?? {}, form).items ?? {}, own = { ...context(), changed: () => { if (push["roles"] !== undefined || roles.some((one) => one !== "unused")) push["roles"] = roles; later(); } };
    const role = (i: number): HTMLElement => {
      const made = input(roles, i, `${path}.roles[${i}]`, plain(rolesOf, form), own, `Use of frame ${i}`);
      made.querySelector("option[value='']")?.remove();
      (made as HTMLSelectElement).value = String(roles[i]);
      return made;
    };
    // A column of a table, pasted into one force, fills those below it, too; a row of it may be empty.
    const pasted = (event: Event, first: number): void => {
      const text = ((event as ClipboardEvent).clipboardData?.getData("text") ?? "").trimEnd();
      const found = (text.includes("\n") ? text.split("\n") : text.trim().split(/[\s;]+/)).map(typed);
      if (found.length < 2) return;
      event.preventDefault();
      found.slice(0, forces.length - first).forEach((force, i) => { forces[first + i] = force; });
      later();
      draw();
      body.querySelector<HTMLElement>(`[aria-label="Force in frame ${first}, N"]`)?.focus();
    };
    const rows = forces.map((_, i) => h("tr", { onpaste: (event: Event) => pasted(event, i) }, h("th", { scope: "row" }, `Frame ${i}`),
      h("td", {}, input(forces, i, `${path}.forces_n[${i}]`, { type: "number" }, context(), `Force in frame ${i}, N`), h("span", { class: "unit" }, "N")), h("td", {}, role(i)),
      h("td", {}, h("small", { class: "says", id: sayId(`${path}.forces_n[${i}]`) }), h("small", { class: "says", id: sayId(`${path}.roles[${i}]`) }))));
    return h("fieldset", { class: "push", id: `push-${number}` }, h("legend", {}, sentence(pushNamed(String(push["id"] ?? number + 1)))),
      h("p", { class: "says", id: sayId(path), role: "status" }),
      h("div", { class: "beside" }, h("div", {}, h("div", { class: "grid" }, ...PUSH.map((name) => field(push, name, `${path}.${name}`, told[name] ?? {}, context()))),
        h("table", { class: "frames" }, h("thead", {}, h("tr", {}, h("td", {}), h("th", { scope: "col" }, "Force on the ribs"), h("th", { scope: "col" }, "Use"), h("td", {}))), h("tbody", {}, ...rows)),
        h("p", { class: "says", id: sayId(`${path}.forces_n`) }),
        state.readOnly ? null : gaugeLog(key, number, (found) => { found.slice(0, forces.length).forEach((force, i) => { forces[i] = force; }); later(); draw(); }), h("p", { class: "soft" }, `${wordsOf("pushes.roles", form).help ?? ""} A column of forces can be pasted into the first of them.`)),
      h("figure", { class: "diagram", "data-push": String(number) })),
      views(push, path, schema, context(), now), state.readOnly && !push["markers"] ? null : markers(key, push, number, schema, context(), now, reload),
      state.readOnly ? null : h("p", { class: "row" }, removal(String(push["id"])), h("span", { class: "soft" }, "Its radiographs stay in the folder; what was marked in them goes to the trash.")));
  }

  function removal(id: string): HTMLElement {
    const made = button("Remove this push", () => act(async () => {
      clearTimeout(timer);
      await save();
      const { trash, lines } = await api.removePush(key, id);
      await without(id);
      const back = async (): Promise<void> => {
        need("undo").hidden = true;
        await api.restore(trash);
        await again();
      };
      past.push(back);
      undo.disabled = false;
      undoable(lines.join(" "), async () => {
        // What was changed since can't be taken back without the push.
        if (past.at(-1) === back) past.pop(); else past.length = 0;
        await back();
      });
    }, made), { "aria-label": `Remove this push: ${id}` });
    return made;
  }

  /** A push is gone on the server; what could not be saved of the others stays as it was typed. */
  async function without(id: string): Promise<void> {
    const { values: here } = form;
    here["pushes"] = (here["pushes"] as api.Values[]).filter((push) => push["id"] !== id);
    for (const name of ["scale", "images"]) {
      const told = ((here["xray"] as api.Values | undefined)?.[name] ?? {}) as api.Values;
      for (const image of Object.keys(told)) if (image === `push/${id}` || image.startsWith(`push/${id}/`)) delete told[image];
    }
    form = await api.form(key);
    saved = JSON.stringify(form.values);
    if (!same(here, form.values)) form.values = here;
    draw();
    later();
    document.dispatchEvent(new Event("subject-changed"));
  }

  /** A change by a button: drawn and saved at once, to be taken back by Undo. */
  function now(change: () => void): void { change(); draw(); later(); }

  /** What the server has changed: the form begins anew. */
  async function reload(): Promise<void> {
    past.length = 0;
    await again();
  }
  async function again(): Promise<void> {
    form = await api.form(key);
    saved = JSON.stringify(form.values);
    unanswered = null;
    undo.disabled = !past.length;
    draw();
    tell("saved", "Saved.");
    document.dispatchEvent(new Event("subject-changed"));
  }

  /** Each push's torso, and the way of the rays, show their values; what is being filled in stands out. */
  function pictures(path: string): void {
    focus = path;
    const pushes = (form.values["pushes"] ?? []) as api.Values[];
    const numberOf = (holder: api.Values, name: string): number | null => (typeof holder[name] === "number" ? holder[name] : null);
    const pictured = (prefix: string): string => (path.startsWith(prefix) ? (wordsOf(path.replace(/\[\d+\]$/, ""), form).picture ?? "") : "");
    const drawn = (figure: HTMLElement, picture: SVGElement): void => figure.replaceChildren(picture, h("figcaption", { class: "soft" }, "Not to scale."));
    for (const figure of body.querySelectorAll<HTMLElement>(".diagram")) {
      if (figure.dataset["push"] === undefined) {
        const usual = (form.values["xray"] ?? {}) as api.Values, alone = Object.entries((usual["images"] ?? {}) as Record<string, api.Values>).find(([image]) => path.startsWith(`xray.images.${image}.`));
        const rays = { ...usual, ...alone?.[1] };
        const lengths = (rays["scale"] ?? {}) as Record<string, api.Values>, at = Object.keys(lengths).find((image) => path.startsWith(`xray.scale.${image}.`));
        const length = at ? lengths[at] : Object.values(lengths).find((one) => one["object_mm"] !== undefined);
        drawn(figure, beam({ object: length ? numberOf(length, "object_mm") : null, onDetector: length?.["plane"] === "detector", shown: length?.["object_mm"] !== undefined, detector: numberOf(rays, "source_detector_mm"), patient: numberOf(rays, "source_patient_mm"), pixel: numberOf(rays, "imager_pixel_mm") }, pictured("xray.")));
        continue;
      }
      const number = Number(figure.dataset["push"]), push = pushes[number] ?? {}, forces = ((push["forces_n"] ?? []) as unknown[]).filter((one) => typeof one === "number");
      const shown: Push = { side: (push["side"] as Push["side"]) ?? null, level: numberOf(push, "level"), d21: numberOf(push, "d21_mm"), d31: numberOf(push, "d31_mm"), force: forces.length ? Math.max(...forces) : null };
      if (shown.level !== null && (shown.level < 1 || shown.level > 12)) shown.level = null;
      drawn(figure, torso(shown, pictured(`pushes[${number}].`)));
    }
  }

  const keys = (event: KeyboardEvent): void => {
    if ((event.ctrlKey || event.metaKey) && event.key === "z" && !(event.target instanceof HTMLInputElement)) { event.preventDefault(); undo.click(); }
  };
  const unsaved = (): boolean => unanswered !== null || JSON.stringify(form.values) !== saved;
  const stay = (event: Event): void => { if (unsaved()) event.preventDefault(); };
  const leave = (): void => {
    over = true;
    clearTimeout(timer);
    removeEventListener("keydown", keys);
    removeEventListener("beforeunload", stay);
    if (!unsaved()) return;
    // What is not saved is lost, so that it is told where somebody goes on.
    const told = save().then(() => (unsaved() ? said.textContent : ""), (error: unknown) => `Not saved: ${words(error)}`);
    void told.then((why) => { if (why) problem(`Values of ${String(form.values["id"])}: ${why}`); });
  };
  addEventListener("keydown", keys);
  addEventListener("beforeunload", stay);
  undo.disabled = true;
  draw();
  if (state.readOnly) tell("saved", "To be looked at only.");
  else tell("saved", form.open.length ? "What is marked is still to be filled in. Every change is saved at once." : "Every change is saved at once.");
  return { element: h("div", { class: "values" }, h("div", { class: "row bar" }, undo, said, state.readOnly ? null : next), body), leave };
}
