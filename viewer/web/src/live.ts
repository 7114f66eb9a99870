// The live page: shows a board, and controls it after taking command.

import { Charts, type Panel } from "./charts";
import type { Contact, Fault, FromServer, Scene, State, Status, Vec } from "./data";
import { button, el, number, openSocket, say } from "./dom";
import { excuse } from "./replay";
import { NoWebGL, Stage } from "./stage";

/** Span of the charts [s]. */
const SPAN = 20;
/** Interval between redraws of the charts [ms]. */
const CHART_PERIOD = 80;
/** Time without a message after which the server counts as gone [ms]. */
const SILENCE = 1500;
/** Number of messages over which rate and latency are averaged. */
const WINDOW = 250;

type Command = { do: string } & Record<string, unknown>;

export class Live {
  private socket: WebSocket | null = null;
  private scene: Scene | null = null;
  private state: State | null = null;
  private status: Status | null = null;
  private stage: Stage | null = null;
  private charts: Charts | null = null;
  private heard = 0;
  private charted = 0;
  private pending = false;
  private arrivals: number[] = [];
  private delays: number[] = [];
  private sliders: { input: HTMLInputElement; value: HTMLOutputElement; measured: HTMLElement; held: boolean }[] = [];

  private readonly name = el("h1", {}, "tesaki");
  private readonly badge = el("output", { class: "tv-badge", "data-mode": "lost" }, "connecting");
  private readonly task = el("output", { class: "tv-task" });
  private readonly link = el("output", { class: "tv-link" });
  private readonly notice = el("output", { class: "tv-notice", role: "status" });
  private readonly view = el("div", { class: "tv-stage" });
  private readonly commands = el("div", { class: "tv-commands" });
  private readonly commander = el("p", { class: "tv-commander" });
  private readonly joints = el("div", { class: "tv-joints" });
  private readonly faults = el("section", { class: "tv-card tv-faults" });
  private readonly legend = el("p", { class: "tv-legend" });
  private readonly values = el("dl", { class: "tv-values" });
  private readonly plots = el("div", { class: "tv-charts" });
  private readonly facts = el("p", { class: "tv-facts" });
  private readonly stop = button("Stop", "tv-stop", () => this.send({ do: "stop" }));
  private layout = "";
  private shownFaults = "[]";
  private shownLegend = "";

  constructor(root: HTMLElement) {
    this.faults.hidden = true;
    this.stop.title = "Stops the robot at once, whoever commands it (key: Escape)";
    root.append(
      el("header", { class: "tv-head" }, this.name, this.badge, this.task, el("span", { class: "tv-space" }), this.link, this.stop),
      this.notice,
      el(
        "div",
        { class: "tv-columns" },
        el("div", { class: "tv-left" }, this.view, this.legend, this.values),
        el(
          "div",
          { class: "tv-right" },
          this.faults,
          el("section", { class: "tv-card" }, el("h2", {}, "Command"), this.commander, this.commands),
          el("section", { class: "tv-card" }, el("h2", {}, "Joints"), this.joints),
        ),
      ),
      this.plots,
      this.facts,
    );
    this.openStage();
    addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.send({ do: "stop" });
    });
    setInterval(() => this.watch(), 250);
    this.connect();
  }

  private openStage(): void {
    try {
      this.stage = new Stage(this.view, true);
      this.stage.onLost(() => this.view.prepend(excuse("the browser has dropped its picture: reload the page")));
      this.view.append(button("Fit", "tv-fit", () => this.stage?.fit()));
    } catch (error) {
      if (!(error instanceof NoWebGL)) throw error;
      this.view.append(excuse(error.message));
    }
  }

  /** Explains what is drawn of this robot and of the task that runs. Rebuilt only if changed. */
  private drawLegend({ tips, mode, report }: State): void {
    const task = mode === "enabled" ? report : null;
    const entries: [string, string][] = [["link", "measured"]];
    if (mode === "enabled") entries.push(["ghost", "reference"]);
    if (tips.some((tip) => tip.tared)) entries.push(["force", "measured force"]);
    if (task?.forces?.length) entries.push(["aim", "target force"]);
    if (task?.normals && task.friction) entries.push(["cone", "friction cone"]);
    const shown = JSON.stringify(entries);
    if (shown === this.shownLegend) return;
    this.shownLegend = shown;
    this.legend.replaceChildren(...entries.map(([kind, text]) => el("span", {}, el("i", { class: `tv-key tv-key-${kind}` }), text)));
  }

  private connect(): void {
    const socket = openSocket();
    this.socket = socket;
    socket.addEventListener("message", (event) => this.take(JSON.parse(String(event.data)) as FromServer));
    socket.addEventListener("close", (event) => {
      this.lost(event.reason);
      setTimeout(() => this.connect(), 1000);
    });
  }

  private send(command: Command): void {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(command));
    else if (command.do !== "seen") this.tell("Not sent: there is no connection to `tesaki view`.", false);
  }

  private take(message: FromServer): void {
    this.heard = performance.now();
    switch (message.kind) {
      case "scene":
        this.setScene(message.scene);
        break;
      case "status":
        this.setStatus(message);
        break;
      case "answer":
        this.tell(message.text, message.ok);
        break;
      case "state":
        this.setState(message);
        break;
    }
  }

  private setState(state: State): void {
    const arrived = performance.now();
    // What was done before the fault is no news any more; what went wrong is.
    if (state.mode === "fault" && this.state?.mode !== "fault" && !this.notice.classList.contains("tv-bad")) this.tell("", true);
    this.state = state;
    // Sent at once, not delayed by drawing, because it measures the latency and keeps the robot enabled.
    this.send({ do: "seen", n: state.n });
    this.arrivals.push(arrived);
    if (this.arrivals.length > WINDOW) this.arrivals.shift();
    this.collect(state);
    if (!this.pending) {
      this.pending = true;
      requestAnimationFrame(() => {
        this.pending = false;
        this.draw(arrived);
      });
    }
  }

  private panels(scene: Scene): Panel[] {
    const names = scene.joints.slice(0, scene.driven).map((joint) => joint.name);
    const lines = names.map((label, colour) => ({ label, colour }));
    const panels: Panel[] = [
      { title: "Angle", of: "Joints", unit: "rad", digits: 3, shown: true, lines: [...lines, ...lines.map((line) => ({ ...line, dashed: true }))] },
      { title: "Velocity", of: "Joints", unit: "rad/s", digits: 3, shown: false, lines },
      { title: "Torque", of: "Joints", unit: "N·m", digits: 3, shown: true, lines },
    ];
    if (scene.tips.some((tip) => tip.sensor)) {
      const tips = scene.tips.map(({ name: label }, colour) => ({ label, colour }));
      panels.push({ title: "Force at the tip", of: "Tips", unit: "N", digits: 2, shown: true, lines: tips });
    }
    return panels;
  }

  private collect({ tick, joints, tips }: State): void {
    if (!this.charts) return;
    const column = (index: number) => joints.map((joint) => joint[index]);
    const forces = tips.map(({ force, tared }) => (tared ? Math.hypot(...force) : null));
    this.charts.push(tick / 100, [[...column(0), ...column(2)], column(1), column(3), forces], SPAN);
  }

  private setScene(scene: Scene | null): void {
    this.scene = scene;
    this.charts?.destroy();
    this.charts = null;
    this.joints.replaceChildren();
    this.sliders = [];
    this.layout = "";
    say(this.name, scene?.name ?? "no robot");
    document.title = scene ? `${scene.name} – tesaki` : "tesaki";
    if (!scene) return;
    this.stage?.load(scene);
    this.charts = new Charts(this.plots, this.panels(scene));
    scene.joints.slice(0, scene.driven).forEach((joint, index) => this.addSlider(joint.name, joint.limits, index));
  }

  private addSlider(name: string, [lower, upper]: [number, number], joint: number): void {
    const input = el("input", { type: "range", min: String(lower), max: String(upper), step: "0.001", "aria-label": name, disabled: "" });
    const value = el("output", {}, "–");
    const measured = el("i", { class: "tv-measured" });
    const slider = { input, value, measured, held: false };
    input.addEventListener("input", () => {
      slider.held = true;
      this.send({ do: "goal", joint, angle: Number(input.value) });
    });
    const release = () => (slider.held = false);
    input.addEventListener("change", release);
    this.sliders.push(slider);
    const track = el("span", { class: "tv-slide" }, input, measured);
    this.joints.append(el("label", { title: `${number(lower, 2)} to ${number(upper, 2)} rad` }, el("span", { class: "tv-joint" }, name), track, value));
  }

  /** Draws the last state, which came at `arrived`. */
  private draw(arrived: number): void {
    const { state, scene } = this;
    if (!state || !scene) return;
    const words = { disabled: "disabled", enabled: "enabled", fault: "fault" }[state.mode];
    say(this.badge, words);
    this.badge.dataset.mode = state.mode;
    const phase = state.mode === "enabled" ? (state.report?.phase ?? state.task) : null;
    say(this.task, phase ?? "");
    const measured = state.joints.map((joint) => joint[0]);
    this.stage?.setJoints(measured, state.mode === "enabled" ? state.joints.map((joint) => joint[2]) : null);
    this.drawForces(state);
    this.drawLegend(state);
    const report = state.mode === "enabled" ? state.report : null;
    this.stage?.setTaskFrame(report?.frame, report?.target);
    this.stage?.draw();
    this.delays.push(state.delay[0] + state.delay[1] + performance.now() - arrived);
    if (this.delays.length > WINDOW) this.delays.shift();
    this.drawJoints(state, scene);
    this.drawValues(state);
    const now = performance.now();
    if (now - this.charted > CHART_PERIOD) {
      this.charted = now;
      this.charts?.refresh();
      this.drawLink();
    }
    this.arrange();
  }

  private drawForces({ tips, report, mode }: State): void {
    const holds = mode === "enabled" ? report : null;
    const contacts: Contact[] = tips.flatMap(({ position, force, tared }, tip) => {
      if (!tared) return [];
      // With a known contact, as the force of the finger on the object; else as the force on the tip.
      const normal = holds?.normals?.[tip];
      const shown = normal ? (force.map((part) => -part) as Vec) : force;
      return [{ tip, point: position, force: shown, normal: normal ?? [0, 0, 0], friction: normal ? (holds?.friction ?? 0) : 0 }];
    });
    const aims = (holds?.forces ?? []).map((force, tip) => ({ point: tips[tip]?.position ?? [0, 0, 0], force }));
    this.stage?.setContacts(contacts, aims);
  }

  private drawJoints({ joints, mode, task }: State, scene: Scene): void {
    const mayMove = mode === "enabled" && task === "joint servo" && this.status?.commander === "you";
    this.sliders.forEach((slider, index) => {
      const [angle, , reference] = joints[index] ?? [NaN, 0, NaN, 0];
      const homed = this.status?.homed[index] ?? true;
      say(slider.value, homed ? `${number(angle, 3)}` : "not homed");
      const [lower, upper] = scene.joints[index].limits;
      slider.measured.style.left = `${Math.min(100, Math.max(0, (100 * (angle - lower)) / (upper - lower)))}%`;
      slider.input.disabled = !mayMove;
      const shown = mayMove ? reference : angle;
      if (!slider.held && document.activeElement !== slider.input && Number.isFinite(shown)) slider.input.value = String(shown);
      if (!mayMove) slider.held = false;
    });
  }

  private drawValues({ report }: State): void {
    const rows = report?.values ?? [];
    if (this.values.childElementCount !== 2 * rows.length) {
      this.values.replaceChildren(...rows.flatMap(() => [el("dt"), el("dd")]));
    }
    rows.forEach(([name, value, unit], index) => {
      say(this.values.children[2 * index], name);
      const digits = unit === "ticks" || unit === "ms" ? 0 : unit === "mm" || Math.abs(value) >= 10 ? 1 : 3;
      const remark = name === "smallest singular value" && report?.nearly_singular ? ", nearly singular" : "";
      say(this.values.children[2 * index + 1], `${number(value, digits)} ${unit}`.trim() + remark);
    });
  }

  private drawLink(): void {
    const { arrivals, delays } = this;
    if (arrivals.length < 10) return;
    const rate = (1000 * (arrivals.length - 1)) / (arrivals[arrivals.length - 1] - arrivals[0]);
    const latency = [...delays].sort((a, b) => a - b)[delays.length >> 1];
    say(this.link, `${number(rate, 0)} Hz, ${number(latency, 0)} ms`);
    this.link.title = `${number(rate, 1)} updates a second. From the board's tick to the drawn picture: ${number(latency, 1)} ms, the median of the last ${delays.length}.`;
  }

  private setStatus(status: Status): void {
    this.status = status;
    const supply = this.hasData() && status.supply > 0 ? `, supply ${number(status.supply, 1)} V` : "";
    say(this.facts, `${status.port}, firmware ${status.firmware}${supply}`);
    if (status.trouble) {
      say(this.badge, "no data");
      this.badge.dataset.mode = "lost";
      this.tell(status.trouble, false);
    } else if (this.notice.dataset.trouble) {
      this.tell("", true);
    }
    if (status.trouble) this.notice.dataset.trouble = "yes";
    else delete this.notice.dataset.trouble;
    this.setFaults(status.faults);
    this.arrange();
  }

  /**
   * Shows the last fault, with earlier ones folded away. Rebuilt only if changed, so that they do not fold
   * while in use.
   */
  private setFaults(faults: Fault[]): void {
    const shown = JSON.stringify(faults);
    if (shown === this.shownFaults) return;
    this.shownFaults = shown;
    const article = ({ text, title, likely, remedy }: Fault) =>
      el(
        "article",
        {},
        el("strong", {}, text),
        el("p", {}, title),
        likely ? el("p", {}, el("b", {}, "Likely: "), likely) : null,
        remedy ? el("p", {}, el("b", {}, "Do: "), remedy) : null,
      );
    const [last, ...earlier] = faults.map(article);
    this.faults.hidden = !last;
    this.faults.replaceChildren(el("h2", {}, "Fault"), ...(last ? [last] : []));
    if (earlier.length > 0) {
      const summary = el("summary", {}, earlier.length === 1 ? "The fault before" : `${earlier.length} faults before`);
      this.faults.append(el("details", {}, summary, ...earlier));
    }
  }

  /** Whether the board sends its state. */
  private hasData(): boolean {
    return this.state !== null && this.status?.trouble == null;
  }

  /** Shows the buttons that make sense now. Rebuilt only if changed, so that none vanishes under a click. */
  private arrange(): void {
    const { status, state } = this;
    if (!status) return;
    const { commander } = status;
    const mode = state?.mode ?? "disabled";
    const running = mode === "enabled" ? (state?.task ?? "") : "";
    const hasData = this.hasData();
    const words = {
      nobody: hasData ? "Nobody commands the board. This page only looks." : "There is no data from the board.",
      you: "This page commands the board.",
      page: "Another page commands the board. This page only looks.",
      program: "Another program commands the board, or did last. This page only looks.",
    }[commander];
    const { falls } = status;
    say(this.commander, falls && commander === "you" && mode !== "disabled" ? `${words} Mind: ${falls}.` : words);
    const layout = JSON.stringify([commander, mode, running, status.plans, hasData, status.total]);
    if (layout === this.layout) return;
    this.layout = layout;
    const buttons: HTMLElement[] = [];
    const add = (text: string, command: Command, primary = false) =>
      buttons.push(button(text, primary ? "tv-primary" : "", () => this.send(command)));
    if ((commander === "nobody" || commander === "program") && hasData) add("Take command", { do: "take" }, true);
    if (commander === "you") {
      if (mode === "disabled") {
        add("Enable joints", { do: "enable", task: "joint servo" }, true);
        for (const { task, name } of status.plans) {
          const verb = task === "grasping" ? "Grasp" : "Impedance";
          add(`${verb}: ${name.replace(/\.toml$/, "")}`, { do: "enable", task, plan: name });
        }
        if (this.scene?.tips.some((tip) => tip.sensor)) add("Tare forces", { do: "tare" });
        add("Give back command", { do: "release" });
      }
      if (mode === "enabled") add("Disable", { do: "disable" });
      // What is shown, and nothing that has come since.
      if (mode === "fault" && status.total !== null) add("Clear fault", { do: "clear", total: status.total }, true);
      if (running === "grasping") buttons.push(this.graspPad());
      if (running === "impedance control") buttons.push(this.toolPad());
    }
    this.commands.replaceChildren(...buttons);
  }

  private graspPad(): HTMLElement {
    const step = (text: string, translation: Vec, rotation: Vec = [0, 0, 0]) =>
      button(text, "", () => this.send({ do: "object", translation, rotation }));
    const [mm, rad] = [0.005, 0.1];
    const gravity = this.scene?.gravity ?? [0, 0, 0];
    const size = Math.hypot(...gravity);
    const upwards = (height: number) => gravity.map((part) => (-height * part) / size) as Vec;
    const lifts = size > 0 ? [step("Lift 5 mm", upwards(mm)), step("Lower 5 mm", upwards(-mm))] : [];
    return el(
      "div",
      { class: "tv-pad" },
      ...lifts,
      ...(["x", "y", "z"] as const).flatMap((axis, index) => {
        const along = (size: number) => [0, 1, 2].map((part) => (part === index ? size : 0)) as Vec;
        return [step(`${axis} −5 mm`, along(-mm)), step(`${axis} +5 mm`, along(mm)), step(`turn ${axis} −`, [0, 0, 0], along(-rad)), step(`turn ${axis} +`, [0, 0, 0], along(rad))];
      }),
      button("Put down", "tv-primary", () => this.send({ do: "put_down" })),
      button("Open", "", () => this.send({ do: "open" })),
    );
  }

  private toolPad(): HTMLElement {
    const step = (text: string, translation: Vec) => button(text, "", () => this.send({ do: "tool", translation }));
    return el(
      "div",
      { class: "tv-pad" },
      ...(["x", "y", "z"] as const).flatMap((axis, index) => {
        const along = (size: number) => [0, 1, 2].map((part) => (part === index ? size : 0)) as Vec;
        return [step(`${axis} −20 mm`, along(-0.02)), step(`${axis} +20 mm`, along(0.02))];
      }),
    );
  }

  private tell(text: string, ok: boolean): void {
    say(this.notice, text);
    this.notice.classList.toggle("tv-bad", !ok);
  }

  private watch(): void {
    if (this.heard > 0 && performance.now() - this.heard > SILENCE && this.socket?.readyState === WebSocket.OPEN) {
      this.lost("");
    }
  }

  private lost(reason: string): void {
    this.badge.dataset.mode = "lost";
    say(this.badge, "no connection");
    say(this.task, "");
    say(this.link, "");
    [this.arrivals, this.delays] = [[], []];
    [this.status, this.state] = [null, null];
    this.layout = "";
    this.commands.replaceChildren();
    say(this.commander, "");
    for (const { input } of this.sliders) input.disabled = true;
    this.tell(reason || "`tesaki view` does not answer. This page tries again every second.", false);
    // It disappears with the next status.
    this.notice.dataset.trouble = "yes";
  }

  /** Where the tips are [m], as drawn: for the tests of this page. */
  tipPositions(): Vec[] {
    return this.stage?.tipPositions() ?? [];
  }
}
