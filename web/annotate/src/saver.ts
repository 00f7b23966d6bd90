// Saves what changed, one request at a time, and keeps trying where the server does not answer.
import { Refused, words } from "../../shared/net";
import { save } from "./api";
import type { Marks } from "./marks";

const PAUSE_MS = 120, RETRY_MS = 2500;

export class Saver {
  private wanted: Marks | null = null;
  private busy = false;
  private stopped = false;
  private timer = 0;

  constructor(
    private revision: string,
    private readonly say: (state: "saving" | "saved" | "failed", words: string) => void,
    private readonly missing: (lines: string[]) => void,
  ) {
    addEventListener("beforeunload", (event) => { if (this.unsaved) event.preventDefault(); });
  }

  get unsaved(): boolean { return this.wanted !== null || this.busy; }

  want(marks: Marks): void {
    this.wanted = marks;
    if (this.stopped) return;
    this.say("saving", "Saving …");
    this.later(PAUSE_MS);
  }

  /** Once everything is saved; never, if that is refused. */
  async settled(): Promise<void> {
    while (this.unsaved) await new Promise((done) => setTimeout(done, 40));
  }

  private later(ms: number): void {
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => void this.go(), ms);
  }

  private async go(): Promise<void> {
    if (this.busy || this.stopped || !this.wanted) return;
    const marks = this.wanted;
    this.busy = true;
    this.wanted = null;
    try {
      const done = await save(marks, this.revision);
      this.revision = done.revision;
      this.missing(done.missing);
      if (this.wanted) this.later(0);
      else this.say("saved", `Saved ${new Date().toLocaleTimeString()}`);
    } catch (error) {
      this.wanted ??= marks;
      if (error instanceof Refused) {
        // 409: somebody else wrote; saving again would destroy that.
        this.stopped = error.status === 409 || error.status === 403;
        this.say("failed", `Not saved: ${error.message}`);
      } else {
        this.say("failed", `Not saved. ${words(error)}`);
      }
      if (!(error instanceof Refused) || error.status >= 500) this.later(RETRY_MS);
    } finally {
      this.busy = false;
    }
  }
}
