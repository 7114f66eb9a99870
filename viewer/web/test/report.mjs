// The replay in a report: node test/report.mjs [REPORT.html]; without a report it makes one.

import { execFileSync } from "node:child_process";
import { mkdtempSync, statSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { browser, built, check, root, run } from "./harness.mjs";

await run(async () => {
  let report = process.argv[2];
  if (!report) {
    const out = mkdtempSync(join(tmpdir(), "tesaki-report-"));
    execFileSync(join(built, "host-sim"), ["run", "hand3-turn", "--out", out], { cwd: root, stdio: "ignore" });
    report = join(out, "hand3-turn", "index.html");
  }
  const size = statSync(report).size;
  check(size < 5e6, `the report takes ${(size / 1e6).toFixed(1)} MB`);
  const chrome = await browser();
  const page = await chrome.newPage();
  const [errors, requests] = [[], []];
  page.on("pageerror", (error) => errors.push(String(error)));
  page.on("request", (request) => request.url().startsWith("http") && requests.push(request.url()));
  await page.goto(`file://${resolve(report)}`);
  await page.waitForFunction(() => window.tesaki?.players.length === 1);
  const clock = () => page.locator(".tv-clock").textContent();
  const time = async () => Number.parseFloat(await clock());
  const picture = () => page.evaluate(() => window.tesaki.players[0].picture(160, 120));
  const still = await picture();
  for (const colorScheme of ["light", "dark"]) {
    await page.emulateMedia({ colorScheme });
    const colours = await page.evaluate(() => {
      const joints = [...document.querySelectorAll(".tv-chip")].filter((chip) => /_(swing|bend|curl)$/.test(chip.textContent));
      return joints.map((joint) => getComputedStyle(joint.querySelector(".tv-swatch")).backgroundColor);
    });
    check(colours.length === 9 && new Set(colours).size === 9, `nine joints have nine colours on a ${colorScheme} page`);
  }
  await page.emulateMedia({ colorScheme: "light" });
  // Labels are written from right to left: where one is too long, its sign is cut off at the left edge.
  const [room, needed] = await page.evaluate(() => {
    const context = document.querySelector(".tv-plot canvas").getContext("2d");
    context.save();
    context.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
    const width = context.measureText("−0.00125").width / devicePixelRatio;
    context.restore();
    // Behind the number there are a gap and a tick.
    return [document.querySelector(".tv-plot .u-over").offsetLeft, width + 9];
  });
  check(room >= needed, `the numbers at an axis have ${room} px, and need ${needed.toFixed(0)}`);
  check((await time()) === 0, "it begins at the beginning");
  await page.getByRole("button", { name: "Play" }).click();
  const [from, begin] = await page.evaluate(() => [Number(document.querySelector(".tv-track input").value), performance.now()]);
  await page.waitForTimeout(1000);
  const [to, end] = await page.evaluate(() => [Number(document.querySelector(".tv-track input").value), performance.now()]);
  await page.getByRole("button", { name: "Pause" }).click();
  const [played, passed] = [to - from, (end - begin) / 1000];
  // A frame that is drawn without a graphics card may take a while.
  check(Math.abs(played - passed) < 0.4, `${passed.toFixed(2)} s of play are ${played.toFixed(2)} s of the run`);
  check(await page.evaluate((seconds) => {
    const slider = document.querySelector(".tv-track input");
    slider.value = String(seconds);
    slider.dispatchEvent(new Event("input"));
    return document.querySelector(".tv-phase").textContent.length > 0;
  }, 0.6 * (await page.evaluate(() => Number(document.querySelector(".tv-track input").max)))), "the phase is named");
  check((await picture()) !== still, "the picture is another one at another time");
  await page.locator(".tv-plot .u-over").first().click({ position: { x: 5, y: 30 } });
  check((await time()) < 1, "a click on a chart goes to that time");
  await page.emulateMedia({ media: "print" });
  await page.waitForFunction(() => document.querySelectorAll(".tv-strip img").length > 3);
  check(await page.locator(".tv-strip").isVisible(), "on paper there is a strip of pictures");
  check(requests.length === 0, "nothing was asked for over the network");
  check(errors.length === 0, `no errors in the browser${errors.map((error) => `\n${error}`)}`);
  await chrome.close();
});
