// Begins what the page is for: a live view, or the replays in a report.

import type { Replay } from "./data";
import { Live } from "./live";
import { Player } from "./replay";

declare global {
  interface Window {
    tesaki?: { live?: Live; players: Player[] };
  }
}

const players: Player[] = [];
for (const root of document.querySelectorAll<HTMLElement>(".tv-replay")) {
  const data = root.querySelector("script[type='application/json']");
  if (data?.textContent) players.push(new Player(root, JSON.parse(data.textContent) as Replay));
}
const root = document.querySelector<HTMLElement>(".tv-live");
window.tesaki = { live: root ? new Live(root) : undefined, players };
