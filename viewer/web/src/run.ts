// The page of a run in the simulator, while it is computed and afterwards.

import type { Part, Run, Verdict } from "./data";
import { el, openSocket, say } from "./dom";
import { Player } from "./replay";

export class RunView {
  player: Player | null = null;
  private socket: WebSocket | null = null;
  private shown: string | null = null;
  /** How much has been received. */
  private readonly has = { samples: 0, objects: 0, notes: 0 };
  private isOver = false;

  private readonly name = el("h1", {}, "tesaki");
  private readonly badge = el("output", { class: "tv-badge", "data-mode": "lost" }, "connecting");
  private readonly facts = el("output", { class: "tv-task" });
  private readonly notice = el("output", { class: "tv-notice", role: "status" });
  /** How many limits were met, and the link to the report. */
  private readonly outcome = el("span", { class: "tv-outcome" });
  private readonly verdict = el("section", { class: "tv-card tv-verdict", id: "quantities" });
  private readonly replay = el("div", { class: "tv-replay" });

  constructor(root: HTMLElement) {
    this.verdict.hidden = true;
    root.append(el("header", { class: "tv-head" }, this.name, this.badge, this.facts, el("span", { class: "tv-space" }), this.outcome), this.notice, this.replay, this.verdict);
    this.connect();
  }

  private connect(): void {
    const socket = openSocket();
    this.socket = socket;
    socket.addEventListener("message", ({ data }) => this.take(JSON.parse(String(data)) as Run | Part));
    socket.addEventListener("close", () => {
      this.lost();
      setTimeout(() => this.connect(), 1000);
    });
  }

  private take(message: Run | Part): void {
    if (message.kind === "run") this.begin(message);
    else this.extend(message);
    if (!this.isOver) this.socket?.send(JSON.stringify(this.has));
  }

  private begin({ id, period, about }: Run): void {
    if (id === this.shown) {
      // The same run, after the connection was lost.
      if (this.isOver) return;
      this.setBadge("computing", "enabled");
      this.tell("", true);
      return;
    }
    // Another run has taken the address of the run that is shown.
    if (this.shown !== null) location.reload();
    this.shown = id;
    document.title = `${about.scenario} – tesaki`;
    say(this.name, about.title);
    say(this.facts, `${about.scenario}, seed ${about.seed}, ${about.controller}`);
    this.facts.title = about.about;
    this.setBadge("computing", "enabled");
    this.tell("", true);
    this.player = new Player(this.replay, { scene: about.scene, period, objects: [], notes: [], samples: [] }, true);
    if (!matchMedia("(prefers-reduced-motion: reduce)").matches) this.player.toggle();
  }

  private extend(part: Part): void {
    this.has.samples += part.samples.length;
    this.has.objects += part.objects.length;
    this.has.notes += part.notes.length;
    this.player?.extend(part);
    if (part.end) this.finish(part.end);
  }

  private finish(end: NonNullable<Part["end"]>): void {
    this.isOver = true;
    this.player?.finish();
    if (this.has.samples === 0) {
      const excuse = "error" in end ? "The run ended before anything moved." : "Nothing moves in this scenario.";
      this.replay.replaceChildren(el("p", { class: "tv-excuse" }, excuse));
    }
    if ("error" in end) {
      this.setBadge("ended early", "fault");
      this.tell(end.error, false);
      return;
    }
    const { verdict } = end;
    this.setBadge(verdict.pass ? "passed" : "failed", verdict.pass ? "enabled" : "fault");
    this.tell("", true);
    this.outcome.append(el("a", { href: "#quantities" }, verdict.text), el("a", { href: "report/index.html", class: "tv-report" }, "Report"));
    this.verdict.append(el("h2", {}, "Quantities and their limits"), el("div", { class: "tv-scroll" }, table(verdict)));
    this.verdict.hidden = false;
  }

  private setBadge(text: string, mode: string): void {
    say(this.badge, text);
    this.badge.dataset.mode = mode;
  }

  private tell(text: string, ok: boolean): void {
    say(this.notice, text);
    this.notice.hidden = text === "";
    this.notice.classList.toggle("tv-bad", !ok);
  }

  private lost(): void {
    if (this.isOver) {
      // Everything is here except the report.
      this.outcome.querySelector(".tv-report")?.replaceWith(el("span", {}, "The program has ended; the report is in its folder."));
      return;
    }
    this.setBadge("no connection", "lost");
    const rest = this.has.samples > 0 ? " What was computed until then stays here." : "";
    this.tell(`The run is interrupted, or its program has ended.${rest} This page tries again every second.`, false);
  }
}

function table({ rows }: Verdict): HTMLElement {
  const words = (pass: boolean | null) => (pass === null ? "reported" : pass ? "✓ pass" : "✗ FAIL");
  const row = ({ label, measured, limit, pass, note }: Verdict["rows"][number]) =>
    el(
      "tr",
      pass === null ? {} : { class: pass ? "tv-pass" : "tv-fail" },
      el("td", {}, label, note ? el("small", {}, note) : null),
      el("td", {}, measured),
      el("td", {}, limit),
      el("td", {}, words(pass)),
    );
  const head = el("tr", {}, ...["Quantity", "Measured", "Limit", "Verdict"].map((name) => el("th", {}, name)));
  return el("table", {}, el("thead", {}, head), el("tbody", {}, ...rows.map(row)));
}
