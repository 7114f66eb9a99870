// The replay of a run: in a report, or while the run is computed.

import { Charts, type Panel } from "./charts";
import type { Part, Replay, Sample, Vec } from "./data";
import { button, el, number, say } from "./dom";
import { NoWebGL, Stage } from "./stage";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
/** As fast as it is computed. */
const COMPUTED = "Infinity";
/** Interval between redraws of the charts while a run is computed [ms]. */
const CHART_PERIOD = 250;
/** Number of pictures in the printed strip. */
const PICTURES = 6;

export class Player {
  private readonly stage: Stage | null;
  private charts: Charts | null = null;
  private readonly plots = el("div", { class: "tv-charts" });
  private readonly ticks = el("div", { class: "tv-marks", "aria-hidden": "true" });
  private readonly speeds = el("select", { class: "tv-speed", "aria-label": "Speed" });
  private legend = el("p");
  private readonly slider: HTMLInputElement;
  private readonly play: HTMLButtonElement;
  private readonly clock = el("output", { class: "tv-clock" });
  private readonly phase = el("output", { class: "tv-phase" });
  private readonly strip = el("div", { class: "tv-strip" });
  /** Duration available so far [s]. */
  private length = 0;
  private readonly kinds: Kinds = { reference: false, force: false, cone: false };
  private charted = 0;
  private time = 0;
  private speed = 1;
  private last: number | null = null;

  /** With `isGrowing`, `extend` adds samples until `finish`. */
  constructor(root: HTMLElement, private readonly replay: Replay, private isGrowing = false) {
    const view = el("div", { class: "tv-stage" });
    this.slider = el("input", { type: "range", min: "0", step: String(replay.period), value: "0", "aria-label": "Time" });
    this.slider.addEventListener("input", () => this.seek(Number(this.slider.value)));
    this.play = button("Play", "tv-play", () => this.toggle());
    for (const value of SPEEDS) this.speeds.append(el("option", { value: String(value) }, `${value} ×`));
    if (isGrowing) this.speeds.append(el("option", { value: COMPUTED }, "as computed"));
    this.speeds.value = "1";
    this.speeds.addEventListener("change", () => (this.speed = Number(this.speeds.value)));
    const bar = el("div", { class: "tv-bar" }, this.play, el("div", { class: "tv-track" }, this.ticks, this.slider), this.clock, this.speeds);
    root.append(el("div", { class: "tv-theatre" }, view, this.phase), bar, this.legend, this.strip, this.plots);
    this.stage = open(view, replay, isGrowing);
    root.addEventListener("keydown", (event) => this.key(event));
    root.tabIndex = -1;
    this.tellKinds(replay.samples);
    this.measure();
    this.draw();
    this.seek(0);
    if (this.stage && !isGrowing) this.preparePrint();
  }

  /** Adds what was computed since. */
  extend({ samples, objects, notes }: Pick<Part, "samples" | "objects" | "notes">): void {
    const { replay } = this;
    const known = replay.samples.length;
    replay.samples.push(...samples);
    replay.notes.push(...notes);
    this.stage?.addObjects(objects);
    const isNew = this.tellKinds(samples);
    this.measure();
    if (isNew || (known === 0 && samples.length > 0)) this.draw();
    else if (samples.length > 0) {
      const values = this.panels(samples).map((panel) => panel.values);
      this.charts?.append(samples.map((_, index) => (known + index) * replay.period), values);
      if (performance.now() - this.charted > CHART_PERIOD) this.chart();
    }
    this.seek(this.time);
  }

  /** Ends the growing replay. */
  finish(): void {
    if (!this.isGrowing) return;
    this.isGrowing = false;
    this.speeds.lastElementChild?.remove();
    if (this.speed === Infinity) {
      this.speed = 1;
      this.speeds.value = "1";
      this.seek(this.length);
    }
    this.chart();
    this.seek(this.time);
    if (this.stage) this.preparePrint();
  }

  /** Records which kinds of values there are. Returns whether one of them is new. */
  private tellKinds(samples: Sample[]): boolean {
    const { kinds } = this;
    const before = JSON.stringify(kinds);
    kinds.reference ||= samples.some((sample) => sample.r !== undefined);
    kinds.force ||= samples.some((sample) => sample.c !== undefined);
    kinds.cone ||= samples.some((sample) => sample.c?.some(({ friction }) => friction > 0));
    return JSON.stringify(kinds) !== before;
  }

  /** Updates the slider and the marks. */
  private measure(): void {
    const { samples, period } = this.replay;
    this.length = Math.max(0, samples.length - 1) * period;
    this.slider.max = String(this.length);
    this.marks();
  }

  /** Updates the charts and the legend. */
  private draw(): void {
    const { samples, period, notes } = this.replay;
    const panels = this.panels(samples);
    this.plots.replaceChildren();
    this.charts = new Charts(this.plots, panels.map(({ panel }) => panel), { seek: (time) => this.seek(time), marks: notes });
    this.charts.load(samples.map((_, index) => index * period), panels.map(({ values }) => values));
    this.charted = performance.now();
    const made = legend(this.kinds);
    this.legend.replaceWith(made);
    this.legend = made;
  }

  private chart(): void {
    this.charted = performance.now();
    this.charts?.refresh();
  }

  /** Returns the quantities of the run that have values. */
  private panels(samples: Sample[]): { panel: Panel; values: (number | null)[][] }[] {
    const { scene } = this.replay;
    const names = scene.joints.slice(0, scene.driven).map((joint) => joint.name);
    const column = (value: (sample: Sample) => number | undefined) => samples.map((sample) => value(sample) ?? null);
    const of_joints = (title: string, unit: string, digits: number, shown: boolean, value: (sample: Sample, joint: number) => number | undefined) => ({
      panel: { title, of: "Joints", unit, digits, shown, lines: names.map((label, colour) => ({ label, colour })) } as Panel,
      values: names.map((_, joint) => column((sample) => value(sample, joint))),
    });
    const angles = of_joints("Angle", "rad", 3, true, (sample, joint) => sample.q[joint]);
    if (this.kinds.reference) {
      angles.panel.lines.push(...names.map((label, colour) => ({ label, colour, dashed: true })));
      angles.values.push(...names.map((_, joint) => column((sample) => sample.r?.[joint])));
    }
    const panels = [
      angles,
      of_joints("Velocity", "rad/s", 3, false, (sample, joint) => sample.v[joint]),
      of_joints("Torque", "N·m", 3, true, (sample, joint) => sample.u[joint]),
    ];
    if (this.kinds.force) {
      const size = (sample: Sample, tip: number) => {
        const forces = sample.c?.filter((contact) => contact.tip === tip).map(({ force }) => Math.hypot(...force));
        return forces?.length ? Math.max(...forces) : 0;
      };
      panels.unshift({
        panel: { title: "Force at the tip", of: "Tips", unit: "N", digits: 2, shown: true, lines: scene.tips.map((tip, colour) => ({ label: tip.name, colour })) },
        values: scene.tips.map((_, tip) => column((sample) => size(sample, tip))),
      });
    }
    return panels;
  }

  /** Marks where phases begin, above the slider. */
  private marks(): void {
    const { ticks } = this;
    this.replay.notes.forEach(({ time, text }, index) => {
      if (index === ticks.childElementCount) ticks.append(el("i", { title: `${number(time, 2)} s: ${text}` }));
      (ticks.children[index] as HTMLElement).style.left = `${Math.min(100, (100 * time) / Math.max(this.length, 1e-9))}%`;
    });
  }

  private key(event: KeyboardEvent): void {
    const typing = event.target instanceof HTMLInputElement || event.target instanceof HTMLSelectElement || event.target instanceof HTMLButtonElement;
    if (event.key === " " && !typing) this.toggle();
    else if (event.key === "ArrowLeft" && !typing) this.seek(this.time - this.replay.period);
    else if (event.key === "ArrowRight" && !typing) this.seek(this.time + this.replay.period);
    else return;
    event.preventDefault();
  }

  toggle(): void {
    if (this.last !== null) {
      this.last = null;
      say(this.play, "Play");
      return;
    }
    if (this.time >= this.length && !this.isGrowing) this.seek(0);
    say(this.play, "Pause");
    this.last = performance.now();
    const advance = (now: number) => {
      if (this.last === null) return;
      const passed = Math.max(0, now - this.last) / 1000;
      const time = passed > 0 ? Math.min(this.length, this.time + this.speed * passed) : this.time;
      this.last = now;
      if (time > this.time) this.seek(time);
      // At the end of the available samples it waits for more.
      if (time >= this.length && !this.isGrowing) this.toggle();
      else requestAnimationFrame(advance);
    };
    requestAnimationFrame(advance);
  }

  /** Shows a time [s]. */
  seek(time: number): void {
    this.time = Math.min(Math.max(time, 0), this.length);
    this.slider.value = String(this.time);
    say(this.clock, `${number(this.time, 2)} / ${number(this.length, 2)} s${this.isGrowing ? " …" : ""}`);
    say(this.phase, this.replay.notes.findLast((note) => note.time <= this.time + 1e-9)?.text ?? "");
    this.charts?.setCursor(this.time);
    this.show(this.time);
  }

  private show(time: number): void {
    const { samples, period } = this.replay;
    if (!this.stage || samples.length === 0) return;
    const at = time / period;
    const first = samples[Math.min(Math.floor(at), samples.length - 1)];
    const second = samples[Math.min(Math.floor(at) + 1, samples.length - 1)];
    const part = at - Math.floor(at);
    // Between two trials the robot jumps to another posture.
    const jumps = first.q.some((value, joint) => Math.abs((second.q[joint] ?? value) - value) > 12 * period);
    const between = (a: number[], b: number[]) => a.map((value, joint) => (jumps ? value : value + part * ((b[joint] ?? value) - value)));
    this.stage.setFrames(time, (part < 0.5 || jumps ? first : second).f ?? []);
    this.stage.setJoints(between(first.q, second.q), first.r && second.r ? between(first.r, second.r) : null);
    this.stage.setContacts(first.c ?? []);
  }

  /** Makes the pictures of the run for print, once the page is idle. */
  private preparePrint(): void {
    const make = () => {
      if (this.strip.childElementCount > 0 || this.last !== null) return;
      for (const time of this.moments()) {
        this.show(time);
        const note = this.replay.notes.findLast((other) => other.time <= time + 1e-9)?.text ?? "";
        const picture = el("img", { src: this.picture(480, 360), alt: `The robot after ${number(time, 2)} s` });
        this.strip.append(el("figure", {}, picture, el("figcaption", {}, `${number(time, 2)} s  ${note}`)));
      }
      this.show(this.time);
    };
    addEventListener("beforeprint", make);
    ("requestIdleCallback" in window ? requestIdleCallback : setTimeout)(make);
  }

  /** Where the tips are [m], as drawn: for the tests of this page. */
  tipPositions(): Vec[] {
    return this.stage?.tipPositions() ?? [];
  }

  picture(width: number, height: number): string {
    return this.stage?.picture(width, height) ?? "";
  }

  /**
   * Returns the times of the pictures: well within the phases if there are about as many phases as pictures,
   * otherwise evenly spread.
   */
  private moments(): number[] {
    const even = Array.from({ length: PICTURES }, (_, index) => ((index + 0.5) * this.length) / PICTURES);
    const begins = this.replay.notes.map((note) => note.time);
    if (begins.length < 3) return even;
    const ends = [...begins.slice(1), this.length];
    const middles = begins.map((begin, index) => begin + 0.85 * (ends[index] - begin));
    const every = Math.max(1, middles.length / PICTURES);
    return Array.from({ length: Math.min(PICTURES, middles.length) }, (_, index) => middles[Math.floor(index * every)]);
  }
}

/** Optional contents of samples. */
interface Kinds {
  reference: boolean;
  force: boolean;
  cone: boolean;
}

function open(view: HTMLElement, replay: Replay, isLive: boolean): Stage | null {
  try {
    const stage = new Stage(view, isLive);
    stage.load(replay.scene);
    stage.addObjects(replay.objects);
    const { f, q, r } = replay.samples[0] ?? { q: [] };
    stage.setFrames(0, f ?? []);
    stage.setJoints(q, r ?? null);
    stage.onLost(() => view.prepend(excuse("the browser has dropped its picture: reload the page")));
    view.append(button("Fit", "tv-fit", () => stage.fit()));
    return stage;
  } catch (error) {
    if (!(error instanceof NoWebGL)) throw error;
    view.append(excuse(error.message));
    return null;
  }
}

/** Returns the reason why there is no picture. */
export function excuse(reason: string): HTMLElement {
  return el(
    "p",
    { class: "tv-excuse" },
    "No picture in three dimensions: this browser cannot do WebGL here (",
    reason,
    "). Switch hardware acceleration on, or use another browser. Everything else works.",
  );
}

function legend({ reference, force, cone }: Kinds): HTMLParagraphElement {
  const entry = (kind: string, text: string) => el("span", {}, el("i", { class: `tv-key tv-key-${kind}` }), text);
  return el(
    "p",
    { class: "tv-legend" },
    entry("link", "the simulated robot"),
    reference ? entry("ghost", "its reference") : null,
    force ? entry("force", "force of a tip") : null,
    cone ? entry("cone", "friction cone") : null,
  );
}
