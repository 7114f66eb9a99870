// Strip charts of any signals, one panel per quantity.

import uPlot from "uplot";
import { el, number, say } from "./dom";
import { lineColour, onThemeChange, theme } from "./theme";

/** A quantity with a line for each of its signals. */
export interface Panel {
  title: string;
  /** What the quantity belongs to. */
  of: "Joints" | "Tips";
  unit: string;
  /** Number of decimals. */
  digits: number;
  lines: { label: string; colour: number; dashed?: boolean }[];
  /** Whether it is shown initially. */
  shown: boolean;
}

interface Drawn {
  panel: Panel;
  values: (number | null)[][];
  plot: uPlot | null;
  box: HTMLElement;
  host: HTMLElement;
  readout: HTMLElement;
}

interface Options {
  /** Called when a chart is clicked at a time. */
  seek?: (time: number) => void;
  /** Where phases begin. */
  marks?: { time: number; text: string }[];
}

/**
 * Returns the range of an axis: around the values, but ±0.1 if all are 0, which uPlot would draw as 0 to 100.
 */
function heights(_: uPlot, low: number | null, high: number | null): [number, number] {
  if (!low && !high) return [-0.1, 0.1];
  return uPlot.rangeNum(low ?? 0, high ?? 0, 0.1, true) as [number, number];
}

export class Charts {
  private times: number[] = [];
  private readonly drawn: Drawn[];
  /** Hidden lines, by `key`. */
  private readonly hidden = new Set<string>();
  private cursor: number | null = null;
  private range: [number, number] = [0, 1];
  private readonly end = new AbortController();

  constructor(private readonly root: HTMLElement, panels: Panel[], private readonly options: Options = {}) {
    this.drawn = panels.map((panel) => {
      const host = el("div", { class: "tv-plot" });
      const readout = el("output", { class: "tv-readout" });
      const heading = el("h3", {}, panel.title, " ", el("small", {}, panel.unit));
      const box = el("section", { class: "tv-panel" }, el("header", {}, heading, readout), host);
      return { panel, values: panel.lines.map(() => []), plot: null, box, host, readout };
    });
    this.root.append(this.picker(), el("div", { class: "tv-panels" }, ...this.drawn.map(({ box }) => box)));
    for (const drawn of this.drawn) drawn.box.hidden = !drawn.panel.shown;
    const resizes = new ResizeObserver(() => this.resize());
    resizes.observe(this.root);
    this.end.signal.addEventListener("abort", () => resizes.disconnect());
    onThemeChange(() => this.rebuild(), this.end.signal);
  }

  /**
   * Removes everything that would keep its values alive: listeners, and plots in the group with a common
   * cursor.
   */
  destroy(): void {
    this.end.abort();
    for (const { plot } of this.drawn) plot?.destroy();
    this.root.replaceChildren();
  }

  /** The controls that select quantities and their signals. */
  private picker(): HTMLElement {
    const quantities = this.drawn.map(({ panel, box }) => {
      const input = el("input", { type: "checkbox" });
      input.checked = panel.shown;
      input.addEventListener("change", () => {
        box.hidden = !input.checked;
        this.rebuild();
      });
      return el("label", { class: "tv-chip" }, input, el("span", {}, panel.title));
    });
    const groups = [...new Set(this.drawn.map(({ panel }) => panel.of))];
    return el(
      "div",
      { class: "tv-picker" },
      el("div", { class: "tv-chips", role: "group", "aria-label": "Quantities" }, ...quantities),
      ...groups.map((of) => el("details", { open: "" }, el("summary", {}, of), el("div", { class: "tv-chips" }, ...this.signals(of)))),
    );
  }

  /** A button for each joint, or for each tip. */
  private signals(of: Panel["of"]): HTMLElement[] {
    const lines = this.drawn.filter(({ panel }) => panel.of === of).flatMap(({ panel }) => panel.lines);
    const labels = [...new Set(lines.map((line) => line.label))];
    const signals = labels.map((label) => {
      const input = el("input", { type: "checkbox", "aria-label": label });
      input.checked = true;
      const swatch = el("i", { class: "tv-swatch", "data-colour": String(lines.find((line) => line.label === label)!.colour) });
      input.addEventListener("change", () => {
        if (input.checked) this.hidden.delete(key(of, label));
        else this.hidden.add(key(of, label));
        this.rebuild();
      });
      const chip = el("label", { class: "tv-chip", title: "Double click: this one alone" }, input, swatch, el("span", {}, label));
      chip.addEventListener("dblclick", () => {
        // As in other viewers, a double click shows only this signal, or all again.
        const alone = labels.every((other) => (other === label) !== this.hidden.has(key(of, other)));
        signals.forEach(({ input }, index) => {
          input.checked = alone || labels[index] === label;
          if (input.checked) this.hidden.delete(key(of, labels[index]));
          else this.hidden.add(key(of, labels[index]));
        });
        this.rebuild();
      });
      return { chip, input };
    });
    return signals.map(({ chip }) => chip);
  }

  /** Sets all values at once, one row per line of each panel. */
  load(times: number[], values: (number | null)[][][]): void {
    this.times = times;
    this.range = [times[0] ?? 0, times.at(-1) ?? 1];
    this.drawn.forEach((drawn, index) => (drawn.values = values[index] ?? drawn.values));
    this.rebuild();
  }

  /** Appends values, which `refresh` draws. */
  append(times: number[], values: (number | null)[][][]): void {
    this.times.push(...times);
    this.drawn.forEach((drawn, panel) => drawn.values.forEach((line, index) => line.push(...values[panel][index])));
    this.range[1] = this.times.at(-1) ?? this.range[1];
  }

  /** Appends one value to each line, and drops what is older than `span`. */
  push(time: number, values: (number | null)[][], span: number): void {
    // Time has gone back: the board was reset.
    if (time < (this.times.at(-1) ?? -Infinity)) this.clear();
    this.times.push(time);
    this.drawn.forEach((drawn, panel) => drawn.values.forEach((line, index) => line.push(values[panel]?.[index] ?? null)));
    const stale = this.times.findIndex((other) => other >= time - span);
    // In batches, because it copies the rest.
    if (stale > 200) {
      this.times.splice(0, stale);
      for (const { values: lines } of this.drawn) for (const line of lines) line.splice(0, stale);
    }
    this.range = [Math.max(time - span, Math.min(this.times[0], time - 5)), time];
  }

  clear(): void {
    this.times = [];
    for (const { values } of this.drawn) for (const line of values) line.length = 0;
  }

  /** Draws the pushed values. */
  refresh(): void {
    for (const { plot, box, values, panel } of this.drawn) {
      if (box.hidden) continue;
      if (!plot) {
        this.rebuild();
        return;
      }
      plot.setData(this.data(values, panel), false);
      plot.setScale("x", { min: this.range[0], max: this.range[1] });
    }
    this.tell();
  }

  /** Places the line of the present time. */
  setCursor(time: number): void {
    this.cursor = time;
    for (const { plot } of this.drawn) plot?.redraw(false);
    this.tell();
  }

  private data(values: (number | null)[][], panel: Panel): uPlot.AlignedData {
    const shown = values.filter((_, index) => !this.hidden.has(key(panel.of, panel.lines[index].label)));
    return [this.times, ...shown];
  }

  /** Shows the present values as text, as long as they are few. */
  private tell(): void {
    const at = this.cursor === null ? this.times.length - 1 : this.nearest(this.cursor);
    for (const { panel, values, readout, box } of this.drawn) {
      if (box.hidden) continue;
      const lines = panel.lines
        .map((line, index) => ({ line, value: values[index][at] }))
        .filter(({ line }) => !line.dashed && !this.hidden.has(key(panel.of, line.label)));
      const text = lines.length <= 3 ? lines.map(({ value }) => (value == null ? "–" : number(value, panel.digits))).join("   ") : "";
      say(readout, text && `${text} ${panel.unit}`);
    }
  }

  private nearest(time: number): number {
    let [low, high] = [0, this.times.length - 1];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle] < time) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  private resize(): void {
    for (const { plot, host } of this.drawn) {
      if (plot && host.clientWidth > 0 && plot.width !== host.clientWidth) {
        plot.setSize({ width: host.clientWidth, height: plot.height });
      }
    }
    if (this.times.length > 0 && this.drawn.some(({ plot, box }) => !plot && !box.hidden)) this.rebuild();
  }

  private rebuild(): void {
    for (const swatch of this.root.querySelectorAll<HTMLElement>("[data-colour]")) {
      swatch.style.background = lineColour(Number(swatch.dataset.colour));
    }
    for (const drawn of this.drawn) {
      drawn.plot?.destroy();
      drawn.plot = null;
      if (drawn.box.hidden || drawn.host.clientWidth === 0) continue;
      drawn.plot = this.build(drawn);
    }
    this.tell();
  }

  private build({ panel, values, host }: Drawn): uPlot {
    const colours = theme();
    const font = "12px system-ui, sans-serif";
    const axis = (extra: uPlot.Axis): uPlot.Axis => ({
      stroke: colours.muted,
      font,
      grid: { stroke: colours.grid, width: 1 },
      ticks: { stroke: colours.grid, width: 1, size: 4 },
      ...extra,
    });
    const lines = panel.lines.filter((line) => !this.hidden.has(key(panel.of, line.label)));
    const options: uPlot.Options = {
      width: host.clientWidth,
      height: 150,
      padding: [8, 22, 0, 0],
      legend: { show: false },
      cursor: { sync: { key: "tesaki" }, points: { show: false }, drag: { x: false, y: false } },
      scales: { x: { time: false, min: this.range[0], max: this.range[1] }, y: { range: heights } },
      series: [
        {},
        ...lines.map((line) => ({
          label: line.label,
          stroke: lineColour(line.colour),
          width: line.dashed ? 1 : 1.5,
          dash: line.dashed ? [5, 4] : undefined,
          points: { show: false },
        })),
      ],
      axes: [
        axis({ size: 26, values: (_, ticks) => ticks.map((tick) => `${number(tick, tick % 1 === 0 ? 0 : 1)} s`) }),
        axis({ size: 72, values: (_, ticks) => ticks.map((tick) => short(tick)) }),
      ],
      hooks: { draw: [(plot) => this.drawMarks(plot)] },
    };
    const plot = new uPlot(options, this.data(values, panel), host);
    const { seek } = this.options;
    if (seek) {
      const at = (event: PointerEvent) => {
        const { left } = plot.over.getBoundingClientRect();
        seek(plot.posToVal(event.clientX - left, "x"));
      };
      plot.over.addEventListener("pointerdown", at);
      plot.over.addEventListener("pointermove", (event) => event.buttons & 1 && at(event));
    }
    return plot;
  }

  /** Draws the beginnings of phases, and the present time. */
  private drawMarks(plot: uPlot): void {
    const { ctx, bbox } = plot;
    const colours = theme();
    const rule = (time: number, colour: string, width: number) => {
      const x = Math.round(plot.valToPos(time, "x", true)) + 0.5;
      if (x < bbox.left || x > bbox.left + bbox.width) return;
      ctx.strokeStyle = colour;
      ctx.lineWidth = width;
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
    };
    ctx.save();
    for (const { time } of this.options.marks ?? []) rule(time, colours.grid, 2 * devicePixelRatio);
    if (this.cursor !== null) rule(this.cursor, colours.accent, 1.5 * devicePixelRatio);
    ctx.restore();
  }
}

/** The key also names the kind, because a tip may have the name of a joint. */
const key = (of: Panel["of"], label: string): string => `${of}/${label}`;

/** Uses as few digits as distinguish the ticks. */
function short(value: number): string {
  const text = Math.abs(value) >= 1e4 || (value !== 0 && Math.abs(value) < 1e-3) ? value.toExponential(0) : String(Number(value.toPrecision(4)));
  return text.replace("-", "−");
}
