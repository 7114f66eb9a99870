// Builds ../bundle from src. With --check: fails if the committed bundle differs.
import { readFileSync, writeFileSync } from "node:fs";
import { build } from "esbuild";

const bundle = new URL("../bundle/", import.meta.url);
const licence = (name) => `${name}:\n${readFileSync(new URL(`node_modules/${name}/LICENSE`, import.meta.url), "utf8")}`;
const banner = `/*! Made by viewer/web/build.mjs. It holds\n\n${["three", "uplot"].map(licence).join("\n")}*/`;

const common = { bundle: true, minify: true, write: false, legalComments: "none", charset: "utf8" };
const script = await build({
  ...common,
  entryPoints: ["src/main.ts"],
  format: "iife",
  target: "es2022",
  banner: { js: banner },
});
const style = await build({ ...common, entryPoints: ["src/style.css"] });

let stale = false;
for (const [name, result] of [["viewer.js", script], ["viewer.css", style]]) {
  // A script inside HTML must not contain the end of its element.
  const text = result.outputFiles[0].text.replaceAll("</script", "<\\/script");
  const path = new URL(name, bundle);
  if (!process.argv.includes("--check")) {
    writeFileSync(path, text);
    console.log(`${name}: ${(text.length / 1000).toFixed(0)} kB`);
  } else if (readFileSync(path, "utf8") !== text) {
    console.error(`viewer/bundle/${name} is not what viewer/web/src gives: run \`npm run build\` in viewer/web`);
    stale = true;
  }
}
process.exitCode = stale ? 1 : 0;
