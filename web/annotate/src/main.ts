// Starts the page: takes the token, asks for the session, opens the first radiograph that is not complete.
import { need } from "../../shared/dom";
import { takeToken, words } from "../../shared/net";
import { theme } from "../../shared/theme";
import * as api from "./api";
import { App } from "./app";
import * as keys from "./keys";
import { Panel, says } from "./panel";
import * as pointer from "./pointer";
import { Stage } from "./stage";

async function start(): Promise<void> {
  theme(need<HTMLSelectElement>("theme"));
  // Under another address than its own it is a room of the workbench.
  need("back").hidden = location.pathname === "/";
  takeToken();
  try {
    const session = await api.session();
    const app = new App(session, new Stage(need<HTMLCanvasElement>("stage")), says);
    const panel = new Panel(app);
    says.refresh = () => panel.refresh();
    pointer.listen(app);
    keys.listen(app);
    says.saved("saved", Object.keys(session.marks).length ? "Opened as saved" : "Nothing marked yet");
    // For whoever automates the page.
    Object.assign(window, { annotation: app });
    const first = session.images.find((image) => session.missing.some((line) => line.startsWith(`${image.name}:`)));
    await app.open((first ?? session.images[0] as api.ImageInfo).name);
    document.body.dataset["state"] = "open";
  } catch (error) {
    says.saved("failed", "Not opened");
    says.problem(words(error));
    document.body.dataset["state"] = "refused";
  }
}

void start();
