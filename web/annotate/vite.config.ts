import { defineConfig } from "vite";
import { built } from "../shared/build";

export default defineConfig(built({
  here: import.meta.dirname,
  out: "../../src/spinestiff/annotate/page",
  styles: ["../shared/base.css", "src/annotate.css"],
}));
