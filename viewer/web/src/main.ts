// Starts the page: a live view, a run that is being computed, or the replays in a report.

import type { Replay } from "./data";
import { Live } from "./live";
import { Player } from "./replay";
import { RunView } from "./run";

declare global {
  interface Window {
    tesaki?: { live?: Live; run?: RunView; players: Player[] };
  }
}

const players: Player[] = [];
for (const root of document.querySelectorAll<HTMLElement>(".tv-replay")) {
  const data = root.querySelector("script[type='application/json']");
  if (data?.textContent) players.push(new Player(root, JSON.parse(data.textContent) as Replay));
}
const live = document.querySelector<HTMLElement>(".tv-live");
const run = document.querySelector<HTMLElement>(".tv-run");
window.tesaki = { live: live ? new Live(live) : undefined, run: run ? new RunView(run) : undefined, players };
