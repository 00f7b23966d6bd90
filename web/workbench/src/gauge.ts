// Forces from the gauge's log: put beside the frames by the server, shown, and taken only when somebody says so.
import { button, h } from "../../shared/dom";
import * as api from "./api";
import { typed } from "./fields";
import { act } from "./page";

/** A log's text as `spinestiff init` reads it: UTF-8, UTF-16 with its mark, else Windows' Western letters. */
const textOf = async (file: File): Promise<string> => {
  const bytes = new Uint8Array(await file.arrayBuffer());
  const mark = (bytes[0] ?? 0) * 256 + (bytes[1] ?? 0);
  if (mark === 0xfffe || mark === 0xfeff) return new TextDecoder(mark === 0xfffe ? "utf-16le" : "utf-16be").decode(bytes);
  try {
    return new TextDecoder("utf-8", { fatal: true }).decode(bytes);
  } catch {
    return new TextDecoder("windows-1252").decode(bytes);
  }
};

const LARGEST = 3 * 2 ** 20;

export function gaugeLog(key: string, push: number, take: (forces: number[]) => void): HTMLElement {
  const id = (name: string): string => `log-${push}-${name}`;
  const text = (name: string, label: string): [HTMLElement, HTMLInputElement] => {
    const box = h("input", { type: "text", id: id(name), autocomplete: "off" });
    return [h("div", { class: "field" }, h("label", { for: id(name) }, label), box), box];
  };
  const choice = (name: string, label: string, units: string[]): [HTMLElement, HTMLSelectElement] => {
    const box = h("select", { id: id(name) }, h("option", { value: "" }, "as the log says"), ...units.map((unit) => h("option", { value: unit }, unit)));
    return [h("div", { class: "field" }, h("label", { for: id(name) }, label), box), box];
  };
  const file = h("input", { type: "file", accept: ".csv,.txt,.tsv,.log,.dat", id: id("file") });
  const [timeField, time] = text("time", "Column of time, if it is not found"), [forceField, force] = text("force", "Column of force, if it is not found");
  const [timeUnitField, timeUnit] = choice("time-unit", "Unit of time", ["s", "ms"]), [forceUnitField, forceUnit] = choice("force-unit", "Unit of force", ["N", "kgf", "lbf"]);
  const [rateField, rate] = text("rate", "Entries a second, Hz, of a log without times");
  const [offsetField, offset] = text("offset", "Time of the log at the first frame, s; else found from the motion");
  const below = h("div", { role: "status" });
  const read = button("Read the log", () => act(async () => {
    below.replaceChildren();
    const chosen = file.files?.[0];
    if (!chosen) throw new Error("choose the log first");
    if (chosen.size > LARGEST) throw new Error(`the log has ${(chosen.size / 2 ** 20).toFixed(1)} MB; at most 3 MB are read`);
    const at = typed(offset.value), hz = typed(rate.value);
    if (typeof at === "string") throw new Error("the time at the first frame is no number");
    if (typeof hz === "string") throw new Error("the entries a second are no number");
    const columns = time.value && force.value ? [time.value, force.value] : hz !== null && force.value ? [force.value] : null;
    below.replaceChildren("Putting it beside the frames …");
    try {
      below.replaceChildren(shown(await api.gaugeLog(key, {
        push, text: await textOf(chosen), ...(columns ? { columns } : {}), ...(hz === null ? {} : { rate_hz: hz }),
        ...(timeUnit.value ? { time_unit: timeUnit.value } : {}), ...(forceUnit.value ? { force_unit: forceUnit.value } : {}), ...(at === null ? {} : { offset_s: at }),
      }), take));
    } catch (error) {
      below.replaceChildren();
      throw error;
    }
  }, read), { id: id("read") });
  return h("details", {}, h("summary", {}, "Forces from a gauge’s log"), h("p", {}, h("label", {}, "A table of time and force (CSV): ", file)),
    h("div", { class: "grid" }, timeUnitField, forceUnitField, timeField, forceField, rateField, offsetField), h("p", {}, read), below);
}

function shown(found: api.GaugeLog, take: (forces: number[]) => void): HTMLElement {
  const seconds = (value: number | null): string => (value === null ? "?" : value.toFixed(2));
  const placed = found.given ? `First frame at ${seconds(found.offset_s)} s of the log, as given.`
    : `First frame at ${seconds(found.offset_s)} s of the log (95 % ${seconds(found.low_s)} to ${seconds(found.high_s)} s), found from the motion; this leaves a frame’s force open by at most ± ${found.open_n?.toFixed(1) ?? "?"} N.`;
  const explained = found.explained === null ? "" : ` The force explains ${Math.round(100 * Math.max(0, found.explained))} % of the picture’s motion.`;
  return h("div", {}, h("p", {}, `Read: ${found.columns}.`), ...found.notes.map((note) => h("p", { class: "soft" }, note)),
    found.placed ? h("p", {}, placed + explained) : h("p", { class: "warn" }, `Where the log begins is not determined: ${found.why}. Give its time at the first frame.`),
    h("p", { class: "shown" }, h("img", { src: found.picture, alt: "The log’s force over time, with the frames, and the picture’s motion" })),
    found.forces_n ? button("Take these forces", () => take(found.forces_n ?? []), { class: "main" }) : null);
}
