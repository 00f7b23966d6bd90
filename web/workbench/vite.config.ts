// One page, one minified classic script and one style sheet, the script with the hash of its sources at its head.
import { createHash } from "node:crypto";
import { copyFileSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { defineConfig } from "vite";

const here = import.meta.dirname;
const out = join(here, "../../src/spinestiff/workbench/page");
const STYLES = ["../shared/base.css", "src/workbench.css"];

// The same list is read by tests/workbench/test_built.py.
function sourceHash(): string {
  const names = ["index.html", "package.json", "package-lock.json", "tsconfig.json", "vite.config.ts"];
  for (const folder of ["src", "../shared"]) for (const name of readdirSync(join(here, folder))) names.push(`${folder}/${name}`);
  const digest = createHash("sha256");
  for (const name of names.sort()) {
    digest.update(`${name}\n`).update(readFileSync(join(here, name), "utf8").replaceAll("\r\n", "\n"));
  }
  return digest.digest("hex");
}

const BANNER = `/*! spinestiff workbench, Apache-2.0; built from web/workbench, do not edit.\nsources sha256 ${sourceHash()}\n*/`;

export default defineConfig({
  build: {
    target: "es2022",
    outDir: out,
    emptyOutDir: false,
    copyPublicDir: false,
    lib: { entry: join(here, "src/main.ts"), formats: ["iife"], name: "spinestiffWorkbench", fileName: () => "workbench.js" },
  },
  plugins: [
    {
      // After the minifier, which drops comments.
      name: "head",
      generateBundle(_, bundle) {
        for (const file of Object.values(bundle)) if (file.type === "chunk") file.code = `${BANNER}\n${file.code.trimEnd()}\n`;
      },
      closeBundle() {
        copyFileSync(join(here, "index.html"), join(out, "index.html"));
        writeFileSync(join(out, "workbench.css"), STYLES.map((name) => readFileSync(join(here, name), "utf8")).join(""));
      },
    },
  ],
});
