// With three.js's licence at the script's head; its style sheet and its page are written where it is shipped.
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { defineConfig } from "vite";
import { built } from "../shared/build";

const licence = readFileSync(join(import.meta.dirname, "node_modules/three/LICENSE"), "utf8").trim();

export default defineConfig(built({
  here: import.meta.dirname,
  out: "../../src/spinestiff/study/report/viewer",
  head: ["Contains three.js and its OrbitControls and Line2, under this licence:", "", licence],
}));
