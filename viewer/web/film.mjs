// Makes an animation of a run: node film.mjs REPORT.html OUT.gif [FROM TO [SPEED]] The report is one of
// `cargo sim run`; FROM and TO are seconds of the run. Needs Chromium.

import { writeFileSync } from "node:fs";
import { resolve } from "node:path";
import gifenc from "gifenc";
import { browser } from "./test/harness.mjs";

const { GIFEncoder, quantize, applyPalette } = gifenc;
const [WIDTH, HEIGHT, RATE, COLOURS] = [420, 320, 10, 63];
const [report, out, from = "0", to = "Infinity", speed = "1"] = process.argv.slice(2);
if (!out) {
  console.error("usage: node film.mjs REPORT.html OUT.gif [FROM TO [SPEED]]");
  process.exit(2);
}
const chrome = await browser();
const page = await chrome.newPage();
await page.goto(`file://${resolve(report)}`);
await page.waitForFunction(() => window.tesaki?.players.length > 0);
const length = await page.evaluate(() => Number(document.querySelector(".tv-track input").max));
const pictures = [];
const end = Math.min(Number(to), length);
for (let time = Number(from); time <= end; time += Number(speed) / RATE) {
  const pixels = await page.evaluate(
    async ([time, width, height]) => {
      const player = window.tesaki.players[0];
      player.seek(time);
      const image = new Image();
      image.src = player.picture(2 * width, 2 * height);
      await image.decode();
      const canvas = Object.assign(document.createElement("canvas"), { width, height });
      const context = canvas.getContext("2d");
      context.imageSmoothingQuality = "high";
      context.drawImage(image, 0, 0, width, height);
      const { data } = context.getImageData(0, 0, width, height);
      let text = "";
      for (let at = 0; at < data.length; at += 8192) text += String.fromCharCode(...data.subarray(at, at + 8192));
      return btoa(text);
    },
    [time, WIDTH, HEIGHT],
  );
  pictures.push(new Uint8Array(Buffer.from(pixels, "base64")));
}

// One palette for all pictures, so that static parts do not flicker. The few bright colours have a part of
// their own.
const grouped = { grey: [], bright: [] };
for (const rgba of pictures) {
  for (let at = 0; at < rgba.length; at += 4 * 7) {
    const pixel = rgba.subarray(at, at + 4);
    const [r, g, b] = pixel;
    grouped[Math.max(r, g, b) - Math.min(r, g, b) > 60 ? "bright" : "grey"].push(...pixel);
  }
}
const BRIGHT = 12;
const colours = (pixels, count) => (pixels.length > 0 ? quantize(Uint8Array.from(pixels), count) : []);
const palette = [...colours(grouped.bright, BRIGHT), ...colours(grouped.grey, COLOURS - BRIGHT)];
while (palette.length <= COLOURS) palette.push([255, 255, 255]);

const gif = GIFEncoder();
let last;
for (const rgba of pictures) {
  const picture = applyPalette(rgba, palette.slice(0, COLOURS));
  // Unchanged pixels are left out.
  const change = last ? picture.map((colour, at) => (colour === last[at] ? COLOURS : colour)) : picture;
  last = picture;
  gif.writeFrame(change, WIDTH, HEIGHT, { palette, delay: 1000 / RATE, transparent: true, transparentIndex: COLOURS, dispose: 1 });
}
gif.finish();
writeFileSync(out, gif.bytes());
console.log(`${out}: ${(gif.bytes().length / 1000).toFixed(0)} kB`);
await chrome.close();
