// Starts the page: takes the token, then goes to the room that the address names.
import { h, need } from "../../shared/dom";
import { takeToken, words } from "../../shared/net";
import { theme } from "../../shared/theme";
import * as api from "./api";
import { cards, trashRoom } from "./cards";
import { compare, table } from "./compare";
import { newcomer } from "./newcomer";
import { problem, reach, type Room, state } from "./page";
import { subject } from "./subject";

const ROOMS: [string, string][] = [["/", "Subjects"], ["/new", "New subject"], ["/compare", "Compare"], ["/table", "Table"], ["/trash", "Trash"]];
let now: Room | null = null, asked = 0;

function rooms(place: string): void {
  need("rooms").replaceChildren(...ROOMS.filter(([path]) => !(state.readOnly && path === "/new")).map(([path, title]) => h("a", { href: `#${path}`, ...(path === place ? { "aria-current": "page" } : {}) }, title)));
}

async function room(place: string): Promise<Room> {
  const [, first = "", second = "", third = ""] = place.split("/");
  if (first === "new") return newcomer();
  if (first === "compare") return compare(second, third);
  if (first === "table") return table();
  if (first === "trash") return trashRoom();
  if (first === "subject") return subject(second, third || "values");
  return cards();
}

async function enter(): Promise<void> {
  const place = location.hash.slice(1) || "/", mine = ++asked;
  now?.leave?.();
  now = null;
  problem("");
  rooms(place);
  document.body.dataset["state"] = "going";
  try {
    const next = await room(place);
    if (mine !== asked) return next.leave?.();
    now = next;
    need("room").replaceChildren(next.element);
    // A room begins at its top, whatever was scrolled to in the one before.
    if (mine > 1) { reach(next.element.querySelector("h1")); scrollTo(0, 0); }
    document.body.dataset["state"] = "open";
  } catch (error) {
    if (mine !== asked) return;
    need("room").replaceChildren(h("p", { class: "soft" }, "Nothing to see here. ", h("a", { href: "#/" }, "All subjects")));
    problem(error);
    document.body.dataset["state"] = "refused";
  }
}

async function start(): Promise<void> {
  theme(need<HTMLSelectElement>("theme"));
  takeToken();
  try {
    const about = await api.bench();
    state.readOnly = about.read_only;
    state.uploadBytes = about.upload_bytes;
    need("state").textContent = about.read_only ? "To be looked at only" : "";
  } catch (error) {
    document.body.dataset["state"] = "refused";
    return problem(words(error));
  }
  // Its address would be that of a room.
  document.querySelector(".skip")?.addEventListener("click", (event) => { event.preventDefault(); need("room").focus(); });
  addEventListener("hashchange", () => void enter());
  await enter();
}

void start();
