// One page, one minified classic script and one style sheet, the script with the hash of its sources at its head.
import { createHash } from "node:crypto";
import { copyFileSync, readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { defineConfig } from "vite";

const here = import.meta.dirname;
const out = join(here, "../../src/spinestiff/annotate/page");

// The same list is read by tests/annotate/test_built.py.
function sourceHash(): string {
  const names = ["index.html", "package.json", "package-lock.json", "tsconfig.json", "vite.config.ts"];
  for (const folder of ["src", "../shared"]) for (const name of readdirSync(join(here, folder))) names.push(`${folder}/${name}`);
  const digest = createHash("sha256");
  for (const name of names.sort()) {
    digest.update(`${name}\n`).update(readFileSync(join(here, name), "utf8").replaceAll("\r\n", "\n"));
  }
  return digest.digest("hex");
}

const BANNER = `/*! spinestiff annotate, Apache-2.0; built from web/annotate, do not edit.\nsources sha256 ${sourceHash()}\n*/`;

export default defineConfig({
  build: {
    target: "es2022",
    outDir: out,
    emptyOutDir: false,
    copyPublicDir: false,
    lib: { entry: join(here, "src/main.ts"), formats: ["iife"], name: "spinestiffAnnotate", fileName: () => "annotate.js" },
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
        copyFileSync(join(here, "src/annotate.css"), join(out, "annotate.css"));
      },
    },
  ],
});
