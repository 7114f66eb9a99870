// The live page in a browser: it shows the true state, its commands are carried out, and only one page has
// command.

import { board, browser, check, checkWithoutWebGl, cpu, run, until } from "./harness.mjs";

await run(async () => {
  const { tesaki, url, server, plant } = await board("hand3");
  const chrome = await browser();
  const errors = [];
  const open = async () => {
    const page = await chrome.newPage({ viewport: { width: 800, height: 480 } });
    page.on("pageerror", (error) => errors.push(String(error)));
    page.on("console", (message) => message.type() === "error" && errors.push(message.text()));
    const begin = Date.now();
    await page.goto(url);
    await page.waitForFunction(() => window.tesaki?.live?.tipPositions().length > 0 && document.querySelector(".tv-badge").textContent !== "connecting");
    return [page, Date.now() - begin];
  };
  const tips = (page) => page.evaluate(() => window.tesaki.live.tipPositions());
  const text = (page, selector) => page.locator(selector).textContent();
  const angles = () => {
    const out = JSON.parse(tesaki("--json", "read"));
    return (out.joints ?? out).map((joint) => joint.position);
  };

  const [first, opened] = await open();
  check(opened < 3000, `the robot is drawn ${opened} ms after the page was asked for`);
  check((await text(first, ".tv-badge")) === "disabled", "it says that the board is disabled");
  check(await first.locator(".tv-joints input").first().isDisabled(), "a page that only looks cannot move a joint");

  const legend = () => text(first, ".tv-legend");
  check((await legend()) === "measured", `the legend names what is drawn: ${await legend()}`);

  await first.getByRole("button", { name: "Take command" }).click();
  await first.getByText("This page commands the board.").waitFor();
  await first.getByRole("button", { name: "Enable joints" }).click();
  await until("the board is enabled", async () => (await text(first, ".tv-badge")) === "enabled");
  check((await legend()) === "measuredreference", `with a task, also its reference: ${await legend()}`);
  const before = await tips(first);
  const slider = first.locator(".tv-joints input").first();
  await slider.evaluate((input) => {
    input.value = "0.4";
    input.dispatchEvent(new Event("input", { bubbles: true }));
    input.dispatchEvent(new Event("change", { bubbles: true }));
  });
  await until("the joint moves in the simulator", () => Math.abs(angles()[0] - 0.4) < 0.02);
  const after = await until("the tip moves on the page", async () => {
    const now = await tips(first);
    return Math.hypot(...now[0].map((part, axis) => part - before[0][axis])) > 0.01 && now;
  });
  check(true, "a joint moves in the simulator and on the page when its slider is moved");
  check(Math.hypot(...after[2].map((part, axis) => part - before[2][axis])) < 0.004, "another finger stands still");

  // The rate, the age and the cost of the pictures. A busy machine gets some time to become less busy.
  const used = [cpu(server), Date.now()];
  const link = async () => (await text(first, ".tv-link")).match(/(\d+) Hz, (\d+) ms/)?.slice(1).map(Number) ?? [0, 1e3];
  const [rate, latency] = await until("50 updates a second, and pictures that are not older than 50 ms", async () => {
    const [rate, latency] = await link();
    return rate >= 49 && rate <= 51 && latency <= 50 && [rate, latency];
  }, 40_000);
  await first.waitForTimeout(1000);
  const share = (1e3 * (cpu(server) - used[0])) / (Date.now() - used[1]);
  check(true, `${rate} updates a second, ${latency} ms from the board's tick to the drawn picture, median`);
  check(share < 0.1, `the server takes ${(100 * share).toFixed(1)} % of a core`);

  const [second] = await open();
  await second.getByText("Another page commands the board.").waitFor();
  check((await second.getByRole("button", { name: "Take command" }).count()) === 0, "a second page is offered no command");
  const refused = await second.evaluate(
    (address) =>
      new Promise((resolve) => {
        const socket = new WebSocket(address.replace("http", "ws") + "/live");
        const answers = [];
        socket.onmessage = ({ data }) => {
          const message = JSON.parse(data);
          if (message.kind === "answer") answers.push(message);
          if (answers.length === 3) resolve(answers);
        };
        socket.onopen = () => {
          for (const command of [{ do: "take" }, { do: "goal", joint: 0, angle: -0.5 }, { do: "disable" }]) socket.send(JSON.stringify(command));
        };
      }),
    url,
  );
  check(refused.every((answer) => !answer.ok && answer.text.includes("another page commands")), "nor can it command past its buttons");
  check(Math.abs(angles()[0] - 0.4) < 0.02, "and the joint has not moved");

  await second.getByRole("button", { name: "Stop", exact: true }).click();
  await until("the board is in fault", () => tesaki("--json", "info").includes("Fault"));
  await first.getByText("Do:").waitFor();
  // Faults come with the status, the mode with the next picture: a busy browser draws it later.
  await until("the page shows the fault", async () => (await text(first, ".tv-badge")) === "fault");
  check(true, "the stop button of a page that only looks stops the robot");
  await until("the page that stopped shows the fault", async () => (await text(second, ".tv-badge")) === "fault");
  check((await text(second, ".tv-notice")) === "", "what was done before the fault does not stand above it");
  check((await text(first, ".tv-faults")).includes("stopped by the supervisor"), "both pages say what has happened and what to do");

  await first.getByRole("button", { name: "Clear fault" }).click();
  await until("the board is disabled", async () => (await text(first, ".tv-badge")) === "disabled");
  await first.getByRole("button", { name: "Enable joints" }).click();
  await until("the board is enabled", async () => (await text(first, ".tv-badge")) === "enabled");
  await first.close();
  await until("the robot is stopped", () => tesaki("--json", "info").includes("Fault"));
  check(true, "the robot is stopped when the page that commands it goes away");
  await second.locator(".tv-faults details:not([open])").waitFor();
  check((await second.locator(".tv-faults > article").count()) === 1, "the last fault stands there, the one before is folded away");
  await second.getByRole("button", { name: "Take command" }).waitFor();
  check(true, "then the other page may take command");

  await checkWithoutWebGl(url);

  check((await text(second, ".tv-facts")).includes(" V"), "the supply is shown while there is data");
  plant.stdin.write("reset\n");
  await second.getByText("There is no data from the board.").waitFor();
  const offered = await second.getByRole("button", { name: "Take command" }).count();
  check(offered === 0 && !(await text(second, ".tv-facts")).includes("supply"), "without data it shows no supply and offers no command");
  check(errors.length === 0, `no errors in the browser${errors.map((error) => `\n${error}`)}`);
  await chrome.close();
});
