// A new subject: its radiographs, and a name.
import { h } from "../../shared/dom";
import * as api from "./api";
import { intake } from "./intake";
import { act, go, type Room } from "./page";
import { last } from "./picture";

const NAME = "[A-Za-z0-9][A-Za-z0-9._\\-]{0,63}";

export const newcomer = (): Promise<Room> => intake({ title: h("h1", {}, "New subject"), rest: [], end: (asked, look, _, used) => [person(asked, look, used)] });

function person(asked: api.Asked, look: api.Look, used: () => void): HTMLElement {
  const name = h("input", { type: "text", id: "name", pattern: NAME, required: true, maxlength: "64", autocomplete: "off", "aria-describedby": "name-help" });
  const make = h("button", { class: "main", id: "make" }, "Make the subject");
  const form = h("form", { class: "plain" },
    h("p", {}, h("label", { for: "name" }, "Name of the subject "), name),
    h("p", { id: "name-help", class: "soft" }, "Letters, digits, '.', '_' or '-'. No person’s name: it stands in the report."),
    ...look.notes.map((note) => h("p", { class: "soft" }, note)), make);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    act(async () => {
      const { key } = await last(() => api.make({ ...asked, ...(look.study ? { study: look.study } : {}), name: name.value, person: {} }));
      used();
      go(`/subject/${key}/values`);
    }, make);
  });
  return form;
}
