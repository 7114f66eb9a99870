// The replay of a run in a report.

import { Charts, type Panel } from "./charts";
import type { Contact, Replay, Sample } from "./data";
import { button, el, number, say } from "./dom";
import { NoWebGL, Stage } from "./stage";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
/** Pictures of the strip for print. */
const PICTURES = 6;

export class Player {
  private readonly stage: Stage | null;
  private readonly charts: Charts;
  private readonly slider: HTMLInputElement;
  private readonly play: HTMLButtonElement;
  private readonly clock = el("output", { class: "tv-clock" });
  private readonly phase = el("output", { class: "tv-phase" });
  private readonly strip = el("div", { class: "tv-strip" });
  private readonly length: number;
  private time = 0;
  private speed = 1;
  private last: number | null = null;

  constructor(root: HTMLElement, private readonly replay: Replay) {
    this.length = (replay.samples.length - 1) * replay.period;
    const view = el("div", { class: "tv-stage" });
    this.slider = el("input", { type: "range", min: "0", max: String(this.length), step: String(replay.period), value: "0", "aria-label": "Time" });
    this.slider.addEventListener("input", () => this.seek(Number(this.slider.value)));
    this.play = button("Play", "tv-play", () => this.toggle());
    const speed = el("select", { "aria-label": "Speed" });
    for (const value of SPEEDS) speed.append(el("option", { value: String(value) }, `${value} ×`));
    speed.value = "1";
    speed.addEventListener("change", () => (this.speed = Number(speed.value)));
    const bar = el("div", { class: "tv-bar" }, this.play, el("div", { class: "tv-track" }, this.marks(), this.slider), this.clock, speed);
    const plots = el("div", { class: "tv-charts" });
    root.append(el("div", { class: "tv-theatre" }, view, this.phase), bar, legend(replay), this.strip, plots);
    this.stage = open(view, replay);
    const panels = this.panels();
    this.charts = new Charts(plots, panels.map(({ panel }) => panel), {
      seek: (time) => this.seek(time),
      marks: replay.notes,
    });
    const times = replay.samples.map((_, index) => index * replay.period);
    this.charts.load(times, panels.map(({ values }) => values));
    root.addEventListener("keydown", (event) => this.key(event));
    root.tabIndex = -1;
    this.seek(0);
    if (this.stage) this.preparePrint();
  }

  /** The quantities of the run, those without values left out. */
  private panels(): { panel: Panel; values: (number | null)[][] }[] {
    const { samples, scene } = this.replay;
    const names = scene.joints.slice(0, scene.driven).map((joint) => joint.name);
    const column = (value: (sample: Sample) => number | undefined) => samples.map((sample) => value(sample) ?? null);
    const of_joints = (title: string, unit: string, digits: number, shown: boolean, value: (sample: Sample, joint: number) => number | undefined) => ({
      panel: { title, unit, digits, shown, lines: names.map((label, colour) => ({ label, colour })) } as Panel,
      values: names.map((_, joint) => column((sample) => value(sample, joint))),
    });
    const angles = of_joints("Angle", "rad", 3, true, (sample, joint) => sample.q[joint]);
    if (samples.some((sample) => sample.r)) {
      angles.panel.lines.push(...names.map((label, colour) => ({ label, colour, dashed: true })));
      angles.values.push(...names.map((_, joint) => column((sample) => sample.r?.[joint])));
    }
    const panels = [
      angles,
      of_joints("Velocity", "rad/s", 3, false, (sample, joint) => sample.v[joint]),
      of_joints("Torque", "N·m", 3, true, (sample, joint) => sample.u[joint]),
    ];
    if (samples.some((sample) => sample.c)) {
      const size = (sample: Sample, tip: number) => {
        const forces = sample.c?.filter((contact) => contact.tip === tip).map(({ force }) => Math.hypot(...force));
        return forces?.length ? Math.max(...forces) : 0;
      };
      panels.unshift({
        panel: { title: "Force at the tip", unit: "N", digits: 2, shown: true, lines: scene.tips.map((tip, colour) => ({ label: tip.name, colour })) },
        values: scene.tips.map((_, tip) => column((sample) => size(sample, tip))),
      });
    }
    return panels;
  }

  /** Where phases begin, above the slider. */
  private marks(): HTMLElement {
    const marks = el("div", { class: "tv-marks", "aria-hidden": "true" });
    for (const { time, text } of this.replay.notes) {
      const mark = el("i", { title: `${number(time, 2)} s: ${text}` });
      mark.style.left = `${(100 * time) / Math.max(this.length, 1e-9)}%`;
      marks.append(mark);
    }
    return marks;
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
    if (this.time >= this.length) this.seek(0);
    say(this.play, "Pause");
    this.last = performance.now();
    const advance = (now: number) => {
      if (this.last === null) return;
      const time = this.time + (this.speed * (now - this.last)) / 1000;
      this.last = now;
      this.seek(time);
      if (time >= this.length) this.toggle();
      else requestAnimationFrame(advance);
    };
    requestAnimationFrame(advance);
  }

  /** Shows a time [s]. */
  seek(time: number): void {
    this.time = Math.min(Math.max(time, 0), this.length);
    this.slider.value = String(this.time);
    say(this.clock, `${number(this.time, 2)} / ${number(this.length, 2)} s`);
    say(this.phase, this.replay.notes.findLast((note) => note.time <= this.time + 1e-9)?.text ?? "");
    this.charts.setCursor(this.time);
    this.show(this.time);
  }

  private show(time: number): void {
    if (!this.stage) return;
    const { samples, period } = this.replay;
    const at = time / period;
    const first = samples[Math.min(Math.floor(at), samples.length - 1)];
    const second = samples[Math.min(Math.floor(at) + 1, samples.length - 1)];
    const part = at - Math.floor(at);
    // Between two trials the robot is at another place at once.
    const jumps = first.q.some((value, joint) => Math.abs((second.q[joint] ?? value) - value) > 12 * period);
    const between = (a: number[], b: number[]) => a.map((value, joint) => (jumps ? value : value + part * ((b[joint] ?? value) - value)));
    this.stage.setFrames(time, (part < 0.5 || jumps ? first : second).f ?? []);
    this.stage.setJoints(between(first.q, second.q), first.r && second.r ? between(first.r, second.r) : null);
    this.stage.setContacts(first.c ?? []);
  }

  /** Pictures of the run for paper, made once the page is at rest. */
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

  picture(width: number, height: number): string {
    return this.stage?.picture(width, height) ?? "";
  }

  /** Times for pictures: well within the phases if there are about as many as pictures, else evenly spread. */
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

function open(view: HTMLElement, replay: Replay): Stage | null {
  try {
    const stage = new Stage(view);
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

/** Why there is no picture. */
export function excuse(reason: string): HTMLElement {
  return el(
    "p",
    { class: "tv-excuse" },
    "No picture in three dimensions: this browser cannot do WebGL here (",
    reason,
    "). Switch hardware acceleration on, or use another browser. Everything else works.",
  );
}

function legend(replay: Replay): HTMLElement {
  const entry = (kind: string, text: string) => el("span", {}, el("i", { class: `tv-key tv-key-${kind}` }), text);
  const has = (test: (sample: Sample) => boolean) => replay.samples.some(test);
  const cones = (contacts: Contact[] | undefined) => contacts?.some(({ friction }) => friction > 0) ?? false;
  return el(
    "p",
    { class: "tv-legend" },
    entry("link", "the simulated robot"),
    has((sample) => sample.r !== undefined) ? entry("ghost", "its reference") : null,
    has((sample) => sample.c !== undefined) ? entry("force", "force of a tip") : null,
    has((sample) => cones(sample.c)) ? entry("cone", "friction cone") : null,
  );
}
