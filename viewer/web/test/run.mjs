// The page of a run, while it is computed and afterwards.

import { mkdtempSync, readFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { browser, check, checkWithoutWebGl, root, run, start, until } from "./harness.mjs";

const out = mkdtempSync(join(tmpdir(), "tesaki-run-"));

/** A run with `--view`, and its address. */
async function begin(scenario, address) {
  const program = start("host-sim", ["run", scenario, `--view=${address}`, "--out", out]);
  const url = await until("the page is served", () => program.text.match(/http:\S+/)?.[0]);
  return [program, url];
}

await run(async () => {
  const chrome = await browser();
  const errors = [];
  const open = async (url) => {
    const page = await chrome.newPage({ viewport: { width: 800, height: 480 } });
    page.on("pageerror", (error) => errors.push(String(error)));
    await page.addInitScript(() => {
      // The range of the slider, each time that it grows.
      window.ends = [];
      const max = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "max");
      Object.defineProperty(HTMLInputElement.prototype, "max", {
        ...max,
        set(value) {
          if (Number(value) > (window.ends.at(-1) ?? 0)) window.ends.push(Number(value));
          max.set.call(this, value);
        },
      });
    });
    await page.goto(url);
    return page;
  };
  const tips = (page) => page.evaluate(() => window.tesaki.run.player?.tipPositions() ?? []);
  const slider = (page) =>
    page.evaluate(() => ["value", "max"].map((name) => Number(document.querySelector(".tv-track input")?.[name] ?? 0)));
  const badge = (page) => page.locator(".tv-badge").textContent();

  const [program, url] = await begin("arm7-straight", "localhost:0");
  const asked = Date.now();
  const first = await open(url);
  const [before] = await until("the arm is drawn", async () => (await slider(first))[1] > 0 && (await tips(first)));
  check(true, `the arm is drawn ${Date.now() - asked} ms after the page was asked for`);
  await until("it moves", async () => {
    const [now] = await tips(first);
    return Math.hypot(...now.map((part, axis) => part - before[axis])) > 0.002;
  }, 40_000);
  check(true, "the arm moves on the page, without a click");
  await first.getByRole("button", { name: "Pause" }).click();
  const [still] = await slider(first);
  await first.waitForTimeout(200);
  check((await slider(first))[0] === still, "it stands while the page pauses");

  await until("the run has ended", async () => (await badge(first)) === "passed", 60_000);
  const ends = await first.evaluate(() => window.ends);
  check(ends.length > 1, `the slider has grown ${ends.length} times`);
  const [value, max] = await slider(first);
  check(value === still, "the end of the run does not move what is shown");
  const summary = JSON.parse(readFileSync(join(out, "arm7-straight", "summary.json"), "utf8"));
  const shown = (summary.ticks - 1) / 100;
  check(max <= shown && shown - max < 0.02, `all ${max} s of the run are there`);
  const sweep = JSON.parse(readFileSync(join(root, "docs/sweeps/development/arm7-straight.json"), "utf8"));
  const recorded = sweep.machines.find(({ seed }) => seed === 1).frames_sha256;
  check(summary.frames_sha256 === recorded, "the run is bit for bit the one without a page");
  const rows = await first.locator(".tv-verdict tbody tr").count();
  check(rows === Object.keys(summary.metrics).length, `${rows} quantities with their limits`);
  check((await first.locator(".tv-speed option").allTextContents()).every((text) => text !== "as computed"), "nothing is computed any more");

  const second = await open(url);
  await until("a page that is opened after the end has all", async () => (await badge(second)) === "passed" && (await slider(second))[1] === max);
  check((await second.locator(".tv-marks i").count()) > 0, "phases are marked");
  await second.getByRole("link", { name: "Report" }).click();
  await second.waitForFunction(() => window.tesaki?.players.length === 1);
  const [, length] = await slider(second);
  check(Math.abs(length - max) < 0.2, "the report is a click away, and as long");
  await second.close();

  await checkWithoutWebGl(url);

  const ended = new Promise((resolve) => program.once("exit", resolve));
  program.kill("SIGINT");
  check((await ended) === 0, "Ctrl-C ends the program, whose run has passed");
  await first.getByText("The program has ended").waitFor();
  check((await slider(first))[1] === max, "the page keeps the run");

  // The longest run, so that it is not over before it is interrupted.
  const [other] = await begin("arm7-paper", new URL(url).host);
  await first.getByText("arm7-paper, seed 1").waitFor();
  await until("the page that was left open shows the next run", async () => (await slider(first))[1] > 0);
  check(true, "the page that was left open shows the next run");
  await first.getByLabel("Speed").selectOption("as computed");
  await until("it keeps up", async () => {
    const [value, max] = await slider(first);
    return value > 10 && max - value < 0.05;
  }, 30_000);
  check(true, "as computed, the page shows the last that there is");
  other.kill("SIGINT");
  await first.getByText("interrupted").waitFor();
  check((await slider(first))[1] > 10, "an interrupted run stays on the page, which says so");

  check(errors.length === 0, `no errors in the browser${errors.map((error) => `\n${error}`)}`);
  await chrome.close();
});
