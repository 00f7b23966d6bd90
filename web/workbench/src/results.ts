// What was found: the result in words, the report and the 3D view in frames of their own, the plan, downloads.
import { button, h } from "../../shared/dom";
import * as api from "./api";
import { act, problem, type Room } from "./page";
import { bars } from "./stiffness";

export async function results(key: string, card: api.Card): Promise<Room> {
  const found = await api.results(key), { result } = found;
  const shown = (name: string): string => `/shown/${found.ticket}/${name}`;
  const frame = h("div", { class: "shown" }), tabs = h("div", { class: "tabs", role: "tablist", "aria-label": "Pages" });
  const all = [...found.pages, ...(found.plan.length || found.parameters.length || found.pictures.length ? [{ name: "", title: "Pictures and plan" }] : [])];
  const older = (): HTMLElement | null => (found.plan_stale.length ? h("p", { class: "warn" }, `This plan is out of date: changed since it was made: ${found.plan_stale.join(", ")}. The room Run makes another one.`) : null);
  const show = (name: string, title: string): void => {
    for (const tab of tabs.querySelectorAll<HTMLElement>("[role=tab]")) {
      tab.setAttribute("aria-selected", String(tab.dataset["name"] === name));
      tab.tabIndex = tab.dataset["name"] === name ? 0 : -1;
    }
    if (name) {
      frame.replaceChildren((name === "protocol.html" && older()) || "", h("p", { class: "row" }, h("a", { href: shown(name), target: "_blank", rel: "noopener" }, "Open in a window of its own, to print it")),
        h("iframe", { src: shown(name), title, sandbox: "allow-scripts allow-downloads" }));
    } else {
      frame.replaceChildren(found.plan.length ? h("div", { class: "card" }, h("h3", {}, "Which push next"), older(), ...found.plan.map((line) => h("p", {}, line))) : "",
        found.parameters.length ? h("div", { class: "card" }, h("h3", {}, "Which parameters at all"), ...found.parameters.map((line) => h("p", {}, line))) : "",
        ...found.pictures.map((one) => h("figure", { class: "card" }, h("figcaption", {}, one.title), h("img", { src: shown(one.name), alt: one.title }))));
    }
  };
  for (const { name, title } of all) {
    const tab = button(title, () => show(name, title), { role: "tab", "data-name": name });
    tab.addEventListener("keydown", (event) => {
      const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (!by) return;
      const next = all[(all.findIndex((one) => one.name === name) + by + all.length) % all.length] as { name: string; title: string };
      show(next.name, next.title);
      tabs.querySelector<HTMLElement>(`[data-name="${next.name}"]`)?.focus();
    });
    tabs.append(tab);
  }
  if (all[0]) show(all[0].name, all[0].title);
  const told = result && !result.problem ? h("div", { class: "card" }, h("h2", {}, "What was found"),
    h("ul", { class: "found" }, ...result.lines.map((line) => h("li", {}, line))), bars([{ name: card.name, result }]),
    ...result.doubts.map((line) => h("p", { class: "bad" }, `To distrust: ${line}`))) : h("p", { class: "soft" }, result?.problem ?? "There is no estimate yet. The room Run makes one.");
  return {
    element: h("div", {}, found.stale.length ? h("p", { class: "warn", role: "status" }, `Changed since this was made: ${found.stale.join(", ")}. Run again to bring the result up to date.`) : null,
      told, all.length ? h("div", {}, tabs, frame) : null, downloads(key, card)),
  };
}

function downloads(key: string, card: api.Card): HTMLElement {
  const looked = h("input", { type: "checkbox", id: "looked" }), said = h("p", { class: "soft", role: "status" });
  const fetchZip = (nameless: boolean): Promise<void> => (async () => {
    said.textContent = "Packing …";
    try {
      const { ticket, bytes } = await api.pack(key, nameless, looked.checked);
      const link = h("a", { href: `/parcel/${ticket}`, download: nameless ? "subject.zip" : `${card.name}.zip` });
      document.body.append(link);
      link.click();
      link.remove();
      said.textContent = `${(bytes / 2 ** 20).toFixed(1)} MB`;
    } catch (error) {
      said.textContent = "";
      problem(error);
    }
  })();
  const all = button("Download everything (zip)", () => act(() => fetchZip(false), all), { id: "zip-all" });
  const bare = button("Download without the patient (zip)", () => act(() => fetchZip(true), bare), { id: "zip-bare" });
  bare.disabled = true;
  looked.addEventListener("change", () => { bare.disabled = !looked.checked; });
  return h("section", { class: "downloads" }, h("h2", {}, "Download"), h("p", { class: "row" }, all, bare),
    h("p", {}, h("label", {}, looked, " I have looked at the radiographs: no name is burned into the pictures.")),
    h("p", { class: "soft" }, "Without the patient: radiographs with everything but picture and geometry left out of their headers, values and annotation under new names; no results."), said);
}
