// Saves what changed, one request at a time, and keeps trying where the server does not answer.
import { Refused, words } from "../../shared/net";
import { save } from "./api";
import type { Marks } from "./marks";

const PAUSE_MS = 120, RETRY_MS = 2500;
// From here on, what stands between page and server has answered in its place.
const BAD_GATEWAY = 502;

export class Saver {
  private wanted: Marks | null = null;
  /** Sent without an answer, so that it may be on disk or not; sent again before anything newer, as nothing but what is there may be. */
  private unanswered: Marks | null = null;
  private busy = false;
  private stopped = false;
  /** Why what is wanted is not saved, where asking again would not help. */
  private refused: Refused | null = null;
  private timer = 0;

  constructor(
    private revision: string,
    private readonly say: (state: "saving" | "saved" | "failed", words: string) => void,
    private readonly missing: (lines: string[]) => void,
  ) {
    addEventListener("beforeunload", (event) => { if (this.unsaved) event.preventDefault(); });
  }

  get unsaved(): boolean { return this.wanted !== null || this.unanswered !== null || this.busy; }

  want(marks: Marks): void {
    this.wanted = marks;
    if (this.stopped) return;
    this.refused = null;
    this.say("saving", "Saving …");
    this.later(PAUSE_MS);
  }

  /** Once everything is saved, or with what it is refused. */
  async settled(): Promise<void> {
    while (this.unsaved) {
      if (this.refused) throw this.refused;
      await new Promise((done) => setTimeout(done, 40));
    }
  }

  private later(ms: number): void {
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => void this.go(), ms);
  }

  private async go(): Promise<void> {
    const marks = this.unanswered ?? this.wanted;
    if (this.busy || this.stopped || !marks) return;
    this.busy = true;
    if (!this.unanswered) this.wanted = null;
    try {
      const done = await save(marks, this.revision);
      this.unanswered = null;
      this.revision = done.revision;
      this.missing(done.missing);
      if (this.wanted) this.later(0);
      else this.say("saved", `Saved ${new Date().toLocaleTimeString()}`);
    } catch (error) {
      const newer = this.wanted !== null, answered = error instanceof Refused && error.status < BAD_GATEWAY;
      this.unanswered = answered ? null : marks;
      if (answered) this.wanted ??= marks;
      if (error instanceof Refused) {
        // 409: somebody else wrote; saving again would destroy that.
        this.stopped = error.status === 409 || error.status === 403;
        if (this.stopped || !newer) this.refused = error;
        this.say("failed", `Not saved: ${error.message}`);
      } else {
        this.say("failed", `Not saved. ${words(error)}`);
      }
      if (!(error instanceof Refused) || error.status >= 500) this.later(RETRY_MS);
      else if (newer) this.later(0);
    } finally {
      this.busy = false;
    }
  }
}
