// A simulated board, `tesaki view`, and a browser, for the tests of the page.

import { execFileSync, spawn } from "node:child_process";
import { existsSync, mkdtempSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { chromium } from "playwright-core";

export const root = new URL("../../../", import.meta.url).pathname;
export const built = resolve(root, process.env.CARGO_TARGET_DIR ?? "target", "release");

export function check(holds, what) {
  if (!holds) throw new Error(`not so: ${what}`);
  console.log(`  ${what}`);
}

/** Waits until a condition holds, and returns its value. */
export async function until(what, test, patience = 8000) {
  const begin = Date.now();
  while (Date.now() - begin < patience) {
    const value = await test();
    if (value) return value;
    await new Promise((resolve) => setTimeout(resolve, 30));
  }
  throw new Error(`not within ${patience / 1000} s: ${what}`);
}

/** Maximum duration of a test [ms]. */
const PATIENCE = 90_000;
const started = [];

/** A program of this workspace, with its output in `text`. */
export function start(program, args, env = {}) {
  const child = spawn(join(built, program), args, { cwd: root, env: { ...process.env, ...env } });
  child.text = "";
  for (const stream of [child.stdout, child.stderr]) stream.on("data", (data) => (child.text += data));
  started.push(child);
  return child;
}

/** A simulated robot with its model, homed if necessary, and a `tesaki view` of it. */
export async function board(robot, { serve = [], view = [] } = {}) {
  const socket = join(mkdtempSync(join(tmpdir(), "tesaki-page-")), "board");
  const port = `unix://${socket}`;
  const plant = start("host-sim", ["serve", "--robot", `robots/${robot}`, "--listen", port, ...serve]);
  await until("the simulated board serves", () => plant.text.includes("Ctrl-C stops") && existsSync(socket));
  const tesaki = (...args) =>
    execFileSync(join(built, "tesaki"), ["--port", port, "--non-interactive", ...args], { cwd: root, encoding: "utf8", stdio: ["ignore", "pipe", "pipe"] });
  tesaki("model", "push", `robots/${robot}`);
  const home = plant.text.match(/tesaki (home .*)/);
  if (home) tesaki(...home[1].trim().split(" "));
  // A busy machine may take longer than the 100 ms that a real one has.
  tesaki("set", "safety.command_timeout", "1");
  const server = start("tesaki", ["--port", port, "view", "--listen", "localhost:0", "--robot", `robots/${robot}`, ...view]);
  const url = await until("the page is served", () => server.text.match(/http:\S+/)?.[0]);
  return { tesaki, url, server, plant, joints: () => JSON.parse(tesaki("--json", "read")) };
}

export async function browser(args = []) {
  const executablePath = process.env.CHROMIUM ?? "/usr/bin/chromium";
  // Without a graphics card, SwiftShader draws.
  return chromium.launch({ executablePath, args: ["--no-sandbox", "--enable-unsafe-swiftshader", ...args] });
}

/** Opens a page in a browser that cannot draw in three dimensions. */
export async function checkWithoutWebGl(url) {
  const blind = await browser(["--disable-gpu", "--disable-3d-apis"]);
  const page = await blind.newPage();
  await page.goto(url);
  await page.getByText("cannot do WebGL").waitFor();
  await page.locator(".tv-plot canvas").first().waitFor();
  check(true, "without WebGL the page says so, and the charts work");
  await blind.close();
}

/** Processor time that a process has used [s]. */
export function cpu(child) {
  const ticks = execFileSync("cat", [`/proc/${child.pid}/stat`], { encoding: "utf8" }).split(") ")[1].split(" ");
  return (Number(ticks[11]) + Number(ticks[12])) / 100;
}

export async function run(test) {
  const begin = Date.now();
  const limit = setTimeout(() => {
    console.error(`not done after ${PATIENCE / 1000} s`);
    started.forEach((child) => child.kill("SIGKILL"));
    process.exit(1);
  }, PATIENCE);
  limit.unref();
  try {
    await test();
    console.log(`passed in ${((Date.now() - begin) / 1000).toFixed(1)} s`);
  } catch (error) {
    console.error(error);
    process.exitCode = 1;
  }
  for (const child of started) child.kill("SIGINT");
  await new Promise((resolve) => setTimeout(resolve, 500));
  for (const child of started) child.kill("SIGKILL");
  // Even if a browser is still open.
  process.exit();
}
