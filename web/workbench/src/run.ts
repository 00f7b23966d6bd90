// Jobs of a subject: started, watched live, cancelled, and what earlier ones said.
import { button, h, svg } from "../../shared/dom";
import { events, words } from "../../shared/net";
import * as api from "./api";
import { jobWords } from "./cards";
import { act, anew, lasted, link, problem, reach, type Room, state } from "./page";

const STEPS: [string, string][] = [
  ["track", "Follow the corners through the pushes"], ["response", "N per degree, without a model"], ["personalise", "Shape the torso to the radiographs"],
  ["estimate", "Estimate the stiffness"], ["assess", "Predict what was held out"], ["report", "Write the report"],
];
const MOST_LINES = 4000, RETRY_MS = 1500;
const changed = (): void => { document.dispatchEvent(new Event("subject-changed")); };
const open = (job: api.Job): boolean => job.state === "running" || job.state === "waiting";

export async function run(key: string, stage: string): Promise<Room> {
  const [verbs, live, history] = [await api.verbs(), h("div"), h("div")];
  let stop = new AbortController(), current: string | null = null, clock = 0;

  async function list(): Promise<void> {
    const jobs = await api.jobs(key);
    const over = jobs.filter((job) => !open(job));
    anew(history, () => history.replaceChildren(...(over.length ? [h("h2", {}, "History"), h("ul", { class: "history" }, ...over.map((job) => h("li", {},
      h("details", { ontoggle: (event: Event) => void logOf(event, job) }, h("summary", {}, `${verbs[job.verb]?.title ?? job.verb}: ${jobWords(job)}${job.began && job.ended ? `, ${lasted(job.ended - job.began)}` : ""}`), h("pre", { tabindex: "0" })))))] : [])));
    const active = jobs.find(open);
    if (active && active.id !== current) watch(active);
    for (const one of starts) {
      // Whoever has started it goes on where it is shown.
      if (active && document.activeElement === one) reach(live.querySelector("h2"));
      one.disabled = active !== undefined || state.readOnly;
    }
  }
  async function logOf(event: Event, job: api.Job): Promise<void> {
    const place = event.target as HTMLDetailsElement, text = place.querySelector("pre");
    if (place.open && text && !text.textContent) text.textContent = (await api.log(job.id)).lines.join("\n") || "It said nothing.";
  }

  function watch(first: api.Job): void {
    stop.abort();
    stop = new AbortController();
    current = first.id;
    const { signal } = stop, view = new Live(first, verbs[first.verb]?.title ?? first.verb, key);
    live.replaceChildren(view.element);
    clearInterval(clock);
    clock = window.setInterval(() => view.tick(), 1000);
    let at = 0, last = first;
    changed();
    void (async () => {
      while (!signal.aborted && open(last)) {
        try {
          await events(`/api/jobs/${first.id}/events?at=${at}`, signal, (name, data, id) => {
            if (name === "lines") { at = Number(id); view.lines(data as string[]); }
            if (name === "job") {
              const before = last.state;
              last = data as api.Job;
              view.state(last);
              if (last.state !== before && open(last)) changed();
            }
          });
          problem("");
        } catch (error) {
          if (signal.aborted) return;
          // The job goes on without this page, and without its server.
          problem(`${words(error)} The job goes on; this page asks again.`);
        }
        if (open(last)) await new Promise((wait) => setTimeout(wait, RETRY_MS));
      }
      clearInterval(clock);
      if (signal.aborted) return;
      current = null;
      changed();
      await list().catch(problem);
    })();
  }

  const starts: HTMLButtonElement[] = [];
  const ready = stage === "run" || stage === "done";
  const cards = Object.entries(verbs).map(([verb, told]) => {
    const given: api.Values = {}, needs = verb !== "plan" && verb !== "view" && !ready;
    const start = button("Start", () => act(async () => {
      // Refused: another window has started one, which is shown.
      try { watch(await api.start(key, verb, given)); } finally { await list(); }
    }), { class: verb === "run" ? "main" : "", "aria-label": `Start: ${told.title}`, id: `start-${verb}` });
    starts.push(start);
    return h("div", { class: `verb${verb === "run" ? " first" : ""}` }, h("h3", {}, told.title), h("p", { class: "soft" }, `${told.about}${told.minutes ? ` Takes ${told.minutes}.` : ""}`),
      ...choices(verb, told.options, given),
      needs ? h("p", { class: "warn" }, "Values or annotation are still missing; it will say what.") : null, start);
  });
  await list();
  const [main, ...others] = cards;
  return {
    element: h("div", {}, live, h("h2", {}, "Steps"), h("div", {}, main as HTMLElement), h("details", {}, h("summary", {}, "Other steps"), h("div", { class: "verbs" }, ...others)), history),
    leave: () => { stop.abort(); clearInterval(clock); },
  };
}

/** A step's options; one that belongs to a value of another is shown, and sent, with that value alone. */
function choices(verb: string, options: Record<string, api.Option>, given: api.Values): HTMLElement[] {
  const made = Object.entries(options).map(([name, option]) => ({ name, option, element: choice(verb, name, option, given) }));
  const settle = (): void => {
    for (const { name, option, element } of made) {
      if (!option.only) continue;
      element.hidden = given[option.only[0]] !== option.only[1];
      if (element.hidden) delete given[name]; else given[name] = element.dataset["value"] ?? "";
    }
  };
  for (const { element } of made) element.querySelector("select")?.addEventListener("change", settle);
  settle();
  return made.map(({ element }) => element);
}

function choice(verb: string, name: string, option: api.Option, given: api.Values): HTMLElement {
  const id = `o-${verb}-${name}`;
  if (option.kind === "text") {
    if (Object.keys(option.fields ?? {}).length) return parts(id, name, option, given);
    const box = h("input", { type: "text", id, autocomplete: "off", maxlength: "60", placeholder: option.example ?? "" });
    box.addEventListener("input", () => { given[name] = box.value; });
    return h("p", {}, h("label", {}, `${option.title} `, box), h("small", { class: "soft" }, ` ${option.help ?? ""} E.g. ${option.example ?? ""}`));
  }
  if (option.kind === "switch") {
    const box = h("input", { type: "checkbox", id });
    box.addEventListener("change", () => { given[name] = box.checked; });
    return h("p", {}, h("label", {}, box, ` ${option.title}`));
  }
  if (option.kind === "choice") {
    const select = h("select", { id }, ...Object.entries(option.words ?? {}).map(([value, text]) => h("option", { value }, text)));
    select.addEventListener("change", () => { given[name] = select.value; });
    return h("p", {}, h("label", {}, `${option.title} `, select));
  }
  const box = h("input", { type: "text", inputmode: "decimal", class: "number", id });
  box.value = String(option.usual ?? "");
  box.addEventListener("input", () => { given[name] = Number(box.value.replace(",", ".")); });
  return h("p", {}, h("label", {}, `${option.title} `, box, option.unit ? ` ${option.unit}` : "", ` (${option.low ?? ""} to ${option.high ?? ""})`));
}

/** A text of several parts, each with a box of its own; as long as one is empty there is none. */
function parts(id: string, name: string, option: api.Option, given: api.Values): HTMLElement {
  const fields = Object.entries(option.fields ?? {}), all = h("p", { class: "row", role: "group", "aria-label": option.title }, option.title);
  const boxes = fields.map(([, kind], i) => (kind.includes("|") ? h("select", { id: `${id}-${i}` }, ...kind.split("|").map((word) => h("option", { value: word }, word)))
    : h("input", { type: "text", inputmode: "decimal", class: "number", id: `${id}-${i}`, autocomplete: "off" })));
  const set = (): void => {
    const values = boxes.map((box) => (box.tagName === "INPUT" ? box.value.trim().replace(",", ".") : box.value));
    all.dataset["value"] = values.every(Boolean) ? values.join(",") : "";
    given[name] = all.dataset["value"];
  };
  boxes.forEach((box, i) => {
    // A box that has the focus when it is hidden says "change" once more.
    box.addEventListener(box.tagName === "INPUT" ? "input" : "change", set);
    all.append(h("label", {}, `${fields[i]?.[0] ?? ""} `, box), box.tagName === "INPUT" ? (fields[i]?.[1] ?? "") : "");
  });
  return all;
}

/** A job while it runs. */
class Live {
  readonly element: HTMLElement;
  private readonly steps = h("ol", { class: "steps" });
  private readonly latest = h("p", { class: "soft", role: "status" });
  private readonly log = h("pre", { tabindex: "0" });
  private readonly whole = h("details", {}, h("summary", {}, "Everything it says"), this.log);
  private readonly title = h("h2");
  private readonly curve = h("figure", { class: "curve" });
  private readonly cancel: HTMLButtonElement;
  private readonly all: string[] = [];
  private losses: number[][] = [];
  private seen: string[] = [];

  constructor(private job: api.Job, private readonly name: string, private readonly key: string) {
    this.cancel = button("Cancel", () => act(async () => { this.state(await api.cancel(this.job.id)); }), { id: "cancel" });
    this.element = h("section", { class: "live", "aria-label": name }, h("div", { class: "row" }, this.title, state.readOnly ? null : this.cancel), this.latest, h("div", { class: "beside" }, this.steps, this.curve), this.whole);
    this.state(job);
  }

  reach(): void { reach(this.title); }

  state(job: api.Job): void {
    this.job = job;
    this.element.dataset["state"] = job.state;
    if ((job.cancel || !open(job)) && document.activeElement === this.cancel) this.reach();
    this.cancel.hidden = !open(job);
    this.cancel.disabled = job.cancel;
    this.cancel.textContent = job.cancel ? "Cancelling …" : "Cancel";
    if (job.state === "done") this.latest.replaceChildren("Done. What was found is under ", link("Results", `/subject/${this.key}/results`), ".");
    if (job.state === "failed") {
      const told = this.all.filter((line) => line.startsWith("spinestiff: ")).map((line) => line.slice(12)).join(" ");
      this.latest.textContent = told || "It failed; what it said last is below.";
      if (!told) this.whole.open = true;
    }
    if (job.state === "cancelled") this.latest.textContent = "Cancelled. What was finished before stays.";
    if (job.state === "lost") this.latest.textContent = "Its process ended without a word, as when the machine is switched off. Start it again: what was finished stays.";
    this.latest.className = job.state === "failed" || job.state === "lost" ? "bad" : "soft";
    this.tick();
    this.draw();
  }

  tick(): void {
    const { job } = this;
    const time = job.began === null ? "" : ` ${lasted((job.ended ?? Date.now() / 1000) - job.began)}`;
    const text = job.state === "waiting" ? `${this.name}: waits until another job is done` : `${this.name}: ${job.state}${time}`;
    if (this.title.textContent !== text) this.title.textContent = text;
  }

  lines(lines: string[]): void {
    for (const line of lines) {
      this.all.push(line);
      const told = /^\s*[\d.]+ s\s+([a-z]+): (.*)$/.exec(line);
      if (!told) continue;
      const [, step, text] = told as unknown as [string, string, string];
      if (!this.seen.includes(step)) this.seen.push(step);
      if (open(this.job)) this.latest.textContent = text.replaceAll("_", " ");
      const loss = /^evaluation (\d+): .*RMSE ([\d.]+) mm$/.exec(text);
      if (loss) {
        if (loss[1] === "0") this.losses.push([]);
        this.losses.at(-1)?.push(Number(loss[2]));
      }
    }
    this.all.splice(0, this.all.length - MOST_LINES);
    const stays = this.log.scrollTop + this.log.clientHeight < this.log.scrollHeight - 8;
    this.log.textContent = this.all.join("\n");
    if (!stays) this.log.scrollTop = this.log.scrollHeight;
    this.draw();
  }

  private draw(): void {
    const known = this.job.verb === "run" ? STEPS : this.seen.map((step): [string, string] => [step, step]), now = this.seen.at(-1);
    this.steps.replaceChildren(...known.map(([step, text]) => {
      const kind = step === now && open(this.job) ? "now" : this.seen.includes(step) ? (step === now && this.job.state !== "done" ? "stopped" : "done") : "open";
      return h("li", { "data-kind": kind, ...(kind === "now" ? { "aria-current": "step" } : {}) }, text);
    }));
    const losses = this.losses.at(-1) ?? [];
    this.curve.hidden = losses.length < 2;
    if (losses.length > 1) this.curve.replaceChildren(curve(losses), h("figcaption", { class: "soft" }, `How far the model’s corners lie from the measured ones: ${losses.at(-1)?.toFixed(2)} mm after ${losses.length} steps of the fit${this.losses.length > 1 ? ` (search ${this.losses.length})` : ""}.`));
  }
}

function curve(losses: number[]): SVGElement {
  const [width, height, left, low] = [280, 120, 34, 18], high = Math.max(...losses), small = Math.min(...losses);
  const [top, bottom] = [Math.log(high * 1.05), Math.log(small * 0.95)];
  const x = (i: number): number => left + ((width - left - 8) * i) / Math.max(1, losses.length - 1), y = (loss: number): number => 8 + ((height - low - 8) * (top - Math.log(loss))) / Math.max(1e-9, top - bottom);
  return svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `Error by step, from ${losses[0]} to ${losses.at(-1)} mm` },
    svg("path", { class: "axis", d: `M${left} 4V${height - low}H${width - 4}` }),
    svg("text", { x: left - 4, y: y(high) + 4, "text-anchor": "end" }, high.toFixed(1)), high / small > 1.3 && svg("text", { x: left - 4, y: y(small) + 4, "text-anchor": "end" }, small.toFixed(1)),
    svg("text", { x: width - 6, y: height - 4, "text-anchor": "end" }, "steps"), svg("text", { x: left + 6, y: 14 }, "mm"),
    svg("polyline", { points: losses.map((loss, i) => `${x(i)},${y(loss)}`).join(" ") }));
}

