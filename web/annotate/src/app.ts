// The state of the page and everything that can be done to it; the mouse, the keyboard and the panels only ask for it here.
import { Refused, words } from "../../shared/net";
import * as api from "./api";
import type { Cobb, ImageInfo, Session, TrackedFrame, Tracking } from "./api";
import { centre, changed, guessed, History, type ImageMarks, type Marks, moved, NOTHING, outermost, type Point, type Quad, removed, renamed, type Selection, selected, type Support, without } from "./marks";
import { Pictures } from "./pictures";
import { Proposals } from "./proposals";
import { Saver } from "./saver";
import { Stage } from "./stage";

export type Tool = "move" | "spine" | "pedicle" | Support;
export interface Says { saved(state: string, words: string): void; problem(words: string, gone?: () => boolean): void; aloud(words: string): void; refresh(): void }

const JUDGE_MS = 60, DETAIL_MS = 120, TRACK_MS = 300, RETRY_MS = 2500, SCREEN_STEP = 64;
const PUSH = /^push\/[^/]+$/, UNTRACKED: Tracking = { state: "none", done: 0, total: 0, error: "", frames: [] };

export class App {
  readonly names: string[];
  image: ImageInfo;
  frame = 0;
  /** The key whose picture is on the stage. */
  loaded = "";
  tool: Tool = "move";
  selection: Selection | null = null;
  cobb: Cobb | null = null;
  curves: Cobb[] = [];
  judged = "";
  missing: string[];
  cursor: Point | null = null;
  show = true;
  busy = "";
  tracking: Record<string, Tracking> = {};
  /** What each push is tracked from, of those that are; see ``starts``. */
  private readonly from: Record<string, Record<string, ImageMarks["vertebrae"]>> = {};
  /** How often the tracking of each push was begun: answers to what was asked before count no more. */
  private readonly rounds: Record<string, number> = {};
  private readonly history: History;
  readonly saver: Saver;
  private draft: ImageMarks | null = null;
  private hidden: Marks = {};
  /** What was last said of the spine's ends, for radiographs in which nothing is. */
  private usual: [string, string];
  private readonly proposals = new Proposals<Quad>();
  private readonly guesses = new Proposals<Point>();
  private readonly pictures = new Pictures();
  private judging = 0;
  private detailing = 0;

  constructor(readonly session: Session, readonly stage: Stage, readonly says: Says) {
    this.names = session.vertebrae;
    this.missing = session.missing;
    const marks = Object.fromEntries(Object.entries(session.marks).map(([name, image]) => [name, { ...NOTHING, ...image }]));
    for (const [key, image] of Object.entries(marks)) {
      if (image.unseen?.length) this.proposals.propose(key, image.unseen.map((name) => image.vertebrae[name]).filter((quad) => quad !== undefined));
      const guessed = Object.entries(image.guessed ?? {}).map(([name, part]) => image.pedicles[name]?.[part]);
      this.guesses.propose(key, guessed.filter((point) => point !== undefined));
    }
    this.history = new History(marks);
    const told = session.images.flatMap(({ name }) => (marks[name] ? [this.endsOf(marks[name])] : []));
    this.usual = told.find((ends) => ends !== null) ?? [this.names[0] as string, this.names[this.names.length - 1] as string];
    this.saver = new Saver(session.revision, says.saved, (lines) => { this.missing = lines; says.refresh(); });
    this.image = session.images[0] as ImageInfo;
    stage.onview = () => this.detail();
  }

  /** Name of what is annotated here: the image, or one of its later frames. */
  get key(): string { return this.frame ? `${this.image.name}/${this.frame}` : this.image.name; }
  get marks(): ImageMarks { return this.draft ?? this.history.marks[this.key] ?? NOTHING; }
  get allMarks(): Marks { return this.history.marks; }
  /** A push's own frames, not one of its radiographs from another side. */
  get isPush(): boolean { return PUSH.test(this.image.name); }
  /** The vertebrae of the first and the last point along the spine: as said, else the outermost that are marked. */
  get ends(): [string, string] { return this.endsOf(this.history.marks[this.image.name] ?? NOTHING) ?? this.usual; }
  private endsOf(marks: ImageMarks): [string, string] | null { return marks.ends ?? outermost(marks, this.names); }
  get canUndo(): boolean { return this.history.canUndo; }
  get canRedo(): boolean { return this.history.canRedo; }
  /** From the side nobody can tell which of two shadows is the left pedicle's. */
  get tools(): Tool[] {
    const pedicle: Tool[] = this.image.kind === "frontal" ? ["pedicle"] : [];
    if (this.frame) return ["move", ...pedicle];
    return this.isPush ? ["move", "spine", "pelvis", "shoulder", ...pedicle] : ["move", "spine", ...pedicle];
  }
  get tracked(): TrackedFrame | null { return this.frame ? (this.tracking[this.image.name]?.frames[this.frame] ?? null) : null; }
  /** Whether what is seen was tracked from other marks than there are now. */
  get outdated(): boolean { return !!this.tracked && this.tracking[this.image.name]?.state === "running"; }

  async open(name: string, frame = 0): Promise<void> {
    const image = this.session.images.find((one) => one.name === name);
    if (!image) return;
    const same = image === this.image && this.stage.size[0] > 1;
    this.settle();
    this.image = image;
    this.frame = Math.min(Math.max(0, frame), image.forces.length - 1);
    if (!this.tools.includes(this.tool)) this.tool = "move";
    if (!same) {
      this.selection = this.cursor = this.cobb = null;
      this.curves = [];
      this.judged = "";
      this.stage.clear();
    }
    const asked = this.key;
    this.says.refresh();
    try {
      const most = this.screen;
      const grey = await this.pictures.get(image.name, this.frame, most);
      if (asked !== this.key) return;
      this.stage.load(grey, same);
      this.loaded = asked;
      if (image.forces.length > 1 && !same) void this.pictures.ahead(image.name, this.frame, image.forces.length, most);
      // Somebody may have tracked it meanwhile, by a command or in the workbench.
      const told = this.tracking[name]?.state;
      if (this.isPush && (!told || (told === "none" && !same))) void this.lookUp(name);
    } catch (error) {
      if (asked === this.key) {
        if (this.loaded !== asked) this.stage.clear();
        this.says.problem(words(error), () => this.key !== asked || this.loaded === asked);
      }
    }
    this.after();
  }

  /** Columns and rows that the screen can show. */
  private get screen(): Point {
    const { clientWidth, clientHeight } = this.stage.canvas;
    const steps = (size: number): number => Math.min(4096, SCREEN_STEP * Math.max(1, Math.ceil((size * devicePixelRatio) / SCREEN_STEP)));
    return [steps(clientWidth), steps(clientHeight)];
  }

  /** Where the screen shows more than was sent, fetch that part finer, once the view rests. */
  private detail(): void {
    clearTimeout(this.detailing);
    this.detailing = window.setTimeout(async () => {
      const { loaded } = this, at = this.selection;
      if (loaded !== this.key) return;
      for (const wanted of this.stage.wanted(at ? selected(this.seen, at)[0] : undefined)) {
        const found = await api.radiograph(this.image.name, this.frame, wanted.most, wanted.part).catch(() => null);
        if (!found || loaded !== this.key) return;
        this.stage.patch(found);
      }
    }, DETAIL_MS);
  }

  // Changes. A drag previews and then commits once.
  /** Without what a drag has previewed. */
  cancel(): void {
    this.draft = null;
    this.after();
  }

  preview(change: (marks: ImageMarks) => ImageMarks): void {
    this.draft = change(this.draft ?? this.adopted(this.selection));
    this.after();
  }

  settle(what = "moved"): void {
    const draft = this.draft;
    this.draft = null;
    if (draft && draft !== this.marks) this.commit(draft, what);
  }

  change(change: (marks: ImageMarks) => ImageMarks | null, what: string): void {
    const next = change(this.marks);
    if (next && next !== this.marks) this.commit(next, what);
  }

  /** A change of what is selected: a tracked vertebra becomes a mark by it. */
  private changeSelected(change: (marks: ImageMarks) => ImageMarks, what: string): void {
    const next = change(this.adopted(this.selection));
    if (next !== this.marks) this.commit(next, what);
  }

  private commit(next: ImageMarks, what: string): void {
    this.replace({ ...this.history.marks, [this.key]: next }, what);
  }

  replace(marks: Marks, what: string): void {
    this.history.commit(marks, this.key, what);
    this.save();
    this.after();
  }

  /** With what nobody has looked at yet; what is tracked from other marks than these is tracked anew. */
  private save(): void {
    const told = Object.entries(this.history.marks).map(([key, image]) =>
      [key, { ...image, unseen: this.proposals.unseen(key, image.vertebrae), guessed: this.guessedIn(key, image) }] as const);
    this.saver.want(Object.fromEntries(told));
    for (const [name, from] of Object.entries(this.from)) {
      const now = this.starts(name);
      if (!Object.keys({ ...from, ...now }).some((key) => from[key] !== now[key])) continue;
      if (name in now) void this.track(name);
      else this.untracked(name);
    }
  }

  /** What a push is tracked from: the vertebrae of its frames in which nothing is proposed or guessed, by key. Pedicles are marked in each frame by themselves. */
  private starts(name: string): Record<string, ImageMarks["vertebrae"]> {
    const frames = Object.entries(this.history.marks).filter(([key, image]) => this.isFrame(key, name) && Object.keys(image.vertebrae).length
      && !this.proposals.unseen(key, image.vertebrae).length && !Object.keys(this.guessedIn(key, image)).length);
    return Object.fromEntries(frames.map(([key, { vertebrae }]) => [key, vertebrae]));
  }
  private isFrame(key: string, push: string): boolean { return key === push || (key.startsWith(`${push}/`) && /^\d+$/.test(key.slice(push.length + 1))); }

  /** Which pedicle of a pair is as it was guessed, 0 the left or 1 the right one, by vertebra. */
  private guessedIn(key: string, { pedicles }: ImageMarks): Record<string, number> {
    return Object.fromEntries(Object.entries(pedicles).flatMap(([name, pair]) => {
      const part = pair.findIndex((point) => this.guesses.isUnseen(key, point));
      return part < 0 ? [] : [[name, part] as const];
    }));
  }

  /** What is shown: marks, and in later frames what was tracked where nothing is marked. */
  get seen(): ImageMarks {
    return this.tracked ? { ...this.marks, vertebrae: { ...this.tracked.vertebrae, ...this.marks.vertebrae } } : this.marks;
  }

  /** Marks to be changed: of a later frame, what was tracked of the one vertebra that is corrected becomes a mark. */
  private adopted(at: Selection | null): ImageMarks {
    const quad = at?.kind === "vertebra" ? this.tracked?.vertebrae[at.name] : undefined;
    if (!at || !quad || this.marks.vertebrae[at.name]) return this.marks;
    return { ...this.marks, vertebrae: { ...this.marks.vertebrae, [at.name]: quad } };
  }

  undo(): void { this.turn(() => this.history.undo(), "undone"); }
  redo(): void { this.turn(() => this.history.redo(), "done again"); }
  private turn(go: () => { image: string; words: string } | null, how: string): void {
    const step = go();
    if (!step) return this.says.aloud("nothing more to take back or do again");
    this.draft = null;
    this.save();
    this.says.aloud(`${step.words}: ${how}`);
    const all = this.session.images, image = all.find((one) => step.image === one.name) ?? all.find((one) => step.image.startsWith(`${one.name}/`));
    if (image && step.image !== this.key) void this.open(image.name, Number(step.image.slice(image.name.length + 1)) || 0);
    else this.after();
  }

  nudge(by: Point): void {
    const at = this.selection;
    if (!at) return this.stage.pan([-40 * Math.sign(by[0]), -40 * Math.sign(by[1])]);
    this.changeSelected((marks) => changed(marks, at, (p) => moved(p, by)), `${this.spoken(at)} moved`);
    this.tell();
  }

  turnBy(degrees: number): void {
    const at = this.selection;
    const quad = at?.kind === "vertebra" ? this.seen.vertebrae[at.name] : undefined;
    if (!at || !quad) return;
    // Turned as it is seen, also where pixels are not square.
    const middle = centre(quad), [wide, high] = this.stage.shape, [cos, sin] = [Math.cos((degrees * Math.PI) / 180), Math.sin((degrees * Math.PI) / 180)];
    const turned = (p: Point): Point => {
      const [x, y] = [wide * (p[0] - middle[0]), high * (p[1] - middle[1])];
      return moved(middle, [(cos * x - sin * y) / wide, (sin * x + cos * y) / high]);
    };
    this.changeSelected((marks) => changed(marks, { ...at, part: -1 }, turned), `${at.name} turned`);
    this.says.aloud(`${at.name} turned by ${degrees} degrees`);
  }

  /** Vertebrae in sight that are as they were proposed and that nobody has looked at. */
  get unseen(): string[] { return this.proposals.unseen(this.key, this.marks.vertebrae); }

  unseenIn(key: string): number { return this.proposals.unseen(key, this.history.marks[key]?.vertebrae ?? {}).length; }

  private look(at: Selection | null): void {
    const quad = at?.kind === "vertebra" ? this.marks.vertebrae[at.name] : undefined;
    const point = at?.kind === "pedicle" ? this.marks.pedicles[at.name]?.[at.part] : undefined;
    if ((quad && this.proposals.look(this.key, quad)) || (point && this.guesses.look(this.key, point))) this.save();
  }

  /** Show the next vertebra that nobody has looked at, large. */
  lookOn(): void {
    const unseen = this.unseen, next = this.names.find((name) => unseen.includes(name));
    const quad = next && this.marks.vertebrae[next];
    if (!quad) return this.says.aloud("every proposed vertebra was looked at");
    this.choose("move");
    this.stage.show(quad);
    this.select({ kind: "vertebra", name: next, part: -1 });
  }

  select(at: Selection | null): void {
    this.selection = at;
    this.look(at);
    const points = at ? selected(this.seen, at) : [];
    if (points.length) this.stage.reveal(centre(points));
    this.tell();
    this.after();
  }

  /** The selected vertebra, or the one that the selected pedicle belongs to. */
  private get chosen(): Selection | null {
    const at = this.selection;
    return at?.kind === "vertebra" || at?.kind === "pedicle" ? at : null;
  }

  /** The next or previous vertebra there is, with the same part of it; of pedicles the next one that is marked. */
  step(by: number): void {
    const { kind, part } = this.chosen ?? { kind: "vertebra" as const, part: -1 };
    const marks = kind === "pedicle" ? this.marks.pedicles : this.seen.vertebrae, have = this.names.filter((name) => marks[name]);
    if (!have.length) return this.says.aloud("no vertebra is marked here");
    const at = this.chosen ? have.indexOf(this.chosen.name) : -1;
    const next = at < 0 ? (by > 0 ? 0 : have.length - 1) : Math.min(have.length - 1, Math.max(0, at + by));
    this.select({ kind, name: have[next] as string, part });
  }

  part(part: number): void {
    const name = this.chosen?.name;
    if (name && this.seen.vertebrae[name]) this.select({ kind: "vertebra", name, part });
  }

  /** Choose a pedicle of the vertebra in hand: 0 is the patient's left one, 1 the right one. */
  pedicle(part: number): void {
    const name = this.chosen?.name;
    if (!name) return this.says.aloud("choose a vertebra first");
    if (!this.marks.pedicles[name]) return this.says.aloud(`no pedicle of ${name} is marked here`);
    this.choose("move");
    this.select({ kind: "pedicle", name, part });
  }

  remove(): void {
    const at = this.selection;
    if (!at || !selected(this.marks, at).length) return;
    if (at.kind === "vertebra") return this.visible(at.name, false);
    this.change((marks) => removed(marks, at), `${at.kind === "pedicle" ? `both pedicles of ${at.name}` : this.spoken(at)} removed`);
    this.selection = null;
    this.after();
  }

  /** A vertebra that can't be seen has no corners; it comes back where it was, or between its neighbours. */
  visible(name: string, on: boolean): void {
    if (!on) {
      const quad = this.marks.vertebrae[name];
      if (quad) this.hidden = { ...this.hidden, [this.key]: { ...(this.hidden[this.key] ?? NOTHING), vertebrae: { ...this.hidden[this.key]?.vertebrae, [name]: quad } } };
      this.change((marks) => removed(marks, { kind: "vertebra", name, part: -1 }), `${name} marked as not visible`);
      if (this.selection?.name === name) this.selection = null;
      this.says.aloud(`${name} is marked as not visible`);
    } else {
      const quad = this.hidden[this.key]?.vertebrae[name] ?? guessed(this.marks, this.names, name);
      if (!quad) this.says.aloud("propose vertebrae first; two are needed to place another");
      else {
        this.change((marks) => ({ ...marks, vertebrae: { ...marks.vertebrae, [name]: quad } }), `${name} added`);
        this.select({ kind: "vertebra", name, part: -1 });
      }
    }
    this.after();
  }

  rename(step: number): void {
    const all = this.history.marks, next = this.named.map((key) => [key, renamed(all[key] ?? NOTHING, this.names, step)] as const);
    if (next.some(([, marks]) => !marks))
      return this.problem(`The names end at ${step < 0 ? "T1" : "L5"}; mark what lies beyond as not visible first.`);
    // What went out of sight has its old name, and at its place is another vertebra by now.
    for (const key of this.named) this.hidden = without(this.hidden, key);
    this.replace({ ...all, ...(Object.fromEntries(next) as Marks) }, step < 0 ? "names moved up" : "names moved down");
    this.selection = null;
    this.says.aloud(step < 0 ? "each vertebra has the name of the one above" : "each vertebra has the name of the one below");
    this.after();
  }

  /** What is named as this radiograph is: of a push its later frames, too, whose vertebrae are tracked from here. */
  private get named(): string[] {
    const later = Object.keys(this.history.marks).filter((key) => key !== this.key && this.isFrame(key, this.key));
    return [this.key, ...(this.isPush ? later : [])];
  }

  /** A point at a place of the radiograph, for the tool in hand. */
  add(p: Point): void {
    const at: Point = [Math.round(p[0] * 100) / 100, Math.round(p[1] * 100) / 100], tool = this.tool;
    const [columns, rows] = this.stage.size;
    if (this.loaded !== this.key) return this.says.aloud("the radiograph is not there yet");
    if (at[0] < -0.5 || at[1] < -0.5 || at[0] > columns - 0.5 || at[1] > rows - 0.5) return;
    if (tool === "spine") this.change((marks) => ({ ...marks, spine: [...marks.spine, at] }), "point along the spine added");
    else if (tool === "pelvis" || tool === "shoulder")
      this.change((marks) => ({ ...marks, supports: { ...marks.supports, [tool]: [...(marks.supports[tool] ?? []), at] } }), `${tool} point added`);
    else if (tool === "pedicle") this.addPedicle(at);
    this.says.aloud(`point at column ${at[0].toFixed(0)}, row ${at[1].toFixed(0)}`);
  }

  /** The other one is guessed until it is set, chosen or moved, too; which is the patient's left follows from the view. */
  private addPedicle(at: Point): void {
    const near = Object.entries(this.seen.vertebrae).map(([name, quad]) => {
      const middle = centre(quad), [wide, high] = this.stage.shape;
      return [Math.hypot(wide * (middle[0] - at[0]), high * (middle[1] - at[1])), name, middle] as const;
    });
    if (!near.length) {
      const { key } = this, first = this.frame ? "Track through the frames" : "Mark the vertebrae";
      return this.problem(`${first} first: a pedicle belongs to the nearest vertebra.`, () => key !== this.key || this.tool !== "pedicle" || Object.keys(this.seen.vertebrae).length > 0);
    }
    const [, name, middle] = near.reduce((a, b) => (b[0] < a[0] ? b : a));
    const first = (at[0] - middle[0]) * this.stage.first[0] + (at[1] - middle[1]) * this.stage.first[1] > 0;
    const mirrored: Point = [Math.round((2 * middle[0] - at[0]) * 100) / 100, at[1]];
    if (!this.marks.pedicles[name]) this.guesses.add(this.key, mirrored);
    this.change((marks) => {
      const pair = marks.pedicles[name] ?? [first ? at : mirrored, first ? mirrored : at];
      const next: [Point, Point] = first ? [at, pair[1]] : [pair[0], at];
      return { ...marks, pedicles: { ...marks.pedicles, [name]: next } };
    }, `pedicle of ${name} marked`);
  }

  choose(tool: Tool): void {
    this.settle();
    this.tool = tool;
    this.cursor = null;
    this.after();
  }

  /** Vertebrae that are not as they were proposed; a new proposal keeps them and takes them for guides. */
  get kept(): Record<string, Quad> { return this.proposals.kept(this.key, this.marks.vertebrae); }

  /** Whether a proposal would keep every vertebra along the points, and so has none to place. */
  get allKept(): boolean {
    const { along, kept } = this;
    return along.length > 0 && along.every((name) => name in kept);
  }
  private get along(): string[] { return this.names.slice(this.names.indexOf(this.ends[0]), this.names.indexOf(this.ends[1]) + 1); }

  /** Say what is wrong until its cause goes: another radiograph or tool, or other marks. */
  problem(text: string, gone?: () => boolean): void {
    const { key, tool, marks } = this;
    this.says.problem(text, gone ?? (() => key !== this.key || tool !== this.tool || marks !== this.marks));
  }

  setEnd(which: 0 | 1, name: string): void {
    const ends: [string, string] = [...this.ends];
    ends[which] = name;
    this.usual = ends;
    this.change((marks) => ({ ...marks, ends }), `the spine's points from ${ends[0]} to ${ends[1]}`);
  }

  async propose(): Promise<void> {
    const { marks, key, ends } = this;
    if (this.busy) return;
    if (this.frame) return this.says.aloud("vertebrae are proposed in a push's first frame; later frames are tracked");
    if (marks.spine.length < 3) {
      this.choose("spine");
      return this.problem(
        "Click at least three points along the spine first: from the uppermost vertebra to the lowest.",
        () => key !== this.key || this.tool !== "spine" || this.marks.spine.length >= 3,
      );
    }
    const { along, kept: before, allKept: anew } = this;
    if (anew && !confirm(`Every vertebra from ${ends[0]} to ${ends[1]} is marked. Propose all of them anew, in place of what is marked? Undo takes it back.`)) return;
    const stays = (all: Record<string, Quad>): Record<string, Quad> =>
      anew ? Object.fromEntries(Object.entries(all).filter(([name, quad]) => !along.includes(name) || quad !== before[name])) : all;
    await this.whileBusy("Proposing …", async () => {
      const found = await api.propose(this.image.name, this.frame, marks.spine, ...ends, stays(before));
      if (key !== this.key) return;
      const kept = stays(this.kept);
      this.proposals.propose(key, Object.entries(found.vertebrae).filter(([name]) => !(name in kept)).map(([, quad]) => quad));
      // Whatever is not visible or renamed later, the points keep their vertebrae.
      this.change((now) => ({ ...now, ends, vertebrae: { ...found.vertebrae, ...kept } }), "proposal");
      this.choose("move");
      this.says.aloud(`${Object.keys(found.vertebrae).length} vertebrae proposed; look at each of them, L shows the next`);
    });
  }

  /** Nothing is left of what was tracked from other marks; once its first frame is whole again, a push is tracked anew. */
  private untracked(name: string): number {
    this.from[name] = this.starts(name);
    this.tracking = { ...this.tracking, [name]: UNTRACKED };
    return this.rounds[name] = (this.rounds[name] ?? 0) + 1;
  }

  /** Track a push from its marks. */
  async track(name = this.image.name): Promise<void> {
    const { frames } = this.tracking[name] ?? UNTRACKED, round = this.untracked(name);
    try {
      this.tracking = { ...this.tracking, [name]: { ...UNTRACKED, state: "running", frames } };
      this.after();
      // The server tracks from what is saved.
      await this.saver.settled();
      if (round === this.rounds[name]) this.watch(name, await api.track(name), round);
    } catch (error) {
      if (round !== this.rounds[name]) return;
      this.tracking = { ...this.tracking, [name]: UNTRACKED };
      this.problem(words(error));
      this.after();
    }
  }

  /** What the server has of a push's tracking, once it knows the marks. */
  private async lookUp(name: string): Promise<void> {
    const round = this.rounds[name] ?? 0;
    try {
      await this.saver.settled();
      const starts = this.starts(name), state = await api.tracking(name);
      if (round !== (this.rounds[name] ?? 0)) return;
      if (state.state !== "none") this.from[name] = starts;
      this.watch(name, state, round);
    } catch (error) {
      this.problem(words(error));
    }
  }

  private watch(name: string, state: Tracking, round = this.rounds[name] ?? 0): void {
    if (round !== (this.rounds[name] ?? 0)) return;
    const before = this.tracking[name];
    // While it runs, frames of the last run stay in sight.
    this.tracking = { ...this.tracking, [name]: state.state === "running" ? { ...state, frames: before?.frames ?? [] } : state };
    if (state.state === "failed") this.says.problem(state.error, () => this.tracking[name]?.state !== "failed");
    if (state.state === "done" && before?.state === "running") this.says.aloud("tracking is done");
    const ask = (): void => void api.tracking(name).then((next) => this.watch(name, next, round), (error: unknown) => {
      if (error instanceof Refused) this.watch(name, { ...state, state: "failed", error: words(error) }, round);
      else window.setTimeout(ask, RETRY_MS);
    });
    if (state.state === "running") window.setTimeout(ask, TRACK_MS);
    this.after();
  }

  async whileBusy(words_: string, act: () => Promise<void>): Promise<void> {
    this.busy = words_;
    this.says.problem("");
    this.says.refresh();
    try { await act(); } catch (error) { this.problem(words(error)); }
    this.busy = "";
    this.after();
  }

  /** Draw, judge and show what is now. */
  after(): void {
    this.paint();
    this.says.refresh();
    if (this.judging) return;
    this.judging = window.setTimeout(() => void this.judge(), JUDGE_MS);
  }

  private paint(): void {
    const { marks, selection, names, cobb, tracked, cursor, show, tool } = this;
    const { lowest_quality: lowest } = this.session, guessed = this.guessedIn(this.key, marks);
    this.stage.draw({ marks, selection, names, cobb, tracked, cursor, show, spine: tool === "spine", lowest, unseen: this.unseen, guessed });
  }

  private async judge(): Promise<void> {
    const { marks, key, tracked, outdated } = this;
    let found: api.Judged = { vertebrae: 0, problem: "", cobb: null, curves: [] };
    try {
      const { vertebrae } = this.seen;
      if (Object.keys(vertebrae).length && !outdated) found = await api.judge(this.image.name, { ...NOTHING, vertebrae, pedicles: marks.pedicles });
    } catch (error) {
      found.problem = words(error);
    }
    if (key === this.key) { this.cobb = found.cobb; this.curves = found.curves; this.judged = found.problem; }
    this.judging = 0;
    if (marks !== this.marks || key !== this.key || tracked !== this.tracked || outdated !== this.outdated) this.after();
    else {
      this.paint();
      this.says.refresh();
    }
  }

  spoken(at: Selection): string {
    const lateral = this.image.kind === "lateral", sides = lateral ? ["anterior", "posterior"] : ["left", "right"];
    if (at.kind === "vertebra")
      return at.part < 0 ? at.name : `${at.name}, ${at.part < 2 ? "superior" : "inferior"} ${sides[at.part === 0 || at.part === 3 ? 0 : 1]} corner`;
    if (at.kind === "pedicle") return `${at.name}, ${at.part ? "right" : "left"} pedicle`;
    return at.kind === "spine" ? `point ${at.part + 1} along the spine` : `${at.kind} point ${at.part + 1}`;
  }

  private tell(): void {
    const at = this.selection;
    if (!at) return;
    const points = selected(this.seen, at);
    if (points.length) {
      const p = centre(points);
      this.says.aloud(`${this.spoken(at)}: column ${p[0].toFixed(1)}, row ${p[1].toFixed(1)}`);
    }
  }

  clearSpine(): void { this.change((marks) => ({ ...marks, spine: [], ends: null }), "points along the spine cleared"); }
}
