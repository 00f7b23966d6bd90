import { defineConfig } from "vite";
import { built } from "../shared/build";

export default defineConfig(built({
  here: import.meta.dirname,
  out: "../../src/spinestiff/workbench/page",
  styles: ["../shared/base.css", "src/workbench.css"],
}));
