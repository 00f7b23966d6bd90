// One minified classic script, with the hash of its sources and three.js's licence at its head.
import { createHash } from "node:crypto";
import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { defineConfig } from "vite";

const here = import.meta.dirname;

// The same list is read by tests/study/report/viewer/test_page.py.
function sourceHash(): string {
  const names = ["package.json", "package-lock.json", "tsconfig.json", "vite.config.ts"];
  for (const name of readdirSync(join(here, "src"))) names.push(`src/${name}`);
  const digest = createHash("sha256");
  for (const name of names.sort()) {
    digest.update(`${name}\n`).update(readFileSync(join(here, name), "utf8").replaceAll("\r\n", "\n"));
  }
  return digest.digest("hex");
}

function banner(): string {
  const licence = readFileSync(join(here, "node_modules/three/LICENSE"), "utf8").trim();
  return [
    "/*! spinestiff viewer, Apache-2.0; built from web/viewer, do not edit.",
    `sources sha256 ${sourceHash()}`,
    "Contains three.js and its OrbitControls and Line2, under this licence:",
    "",
    licence,
    "*/",
  ].join("\n");
}

export default defineConfig({
  build: {
    target: "es2022",
    outDir: join(here, "../../src/spinestiff/study/report/viewer"),
    emptyOutDir: false,
    copyPublicDir: false,
    reportCompressedSize: true,
    lib: { entry: join(here, "src/main.ts"), formats: ["iife"], name: "spinestiffViewer", fileName: () => "viewer.js" },
  },
  plugins: [
    {
      // After the minifier, which drops comments.
      name: "head",
      generateBundle(_, bundle) {
        for (const file of Object.values(bundle)) if (file.type === "chunk") file.code = `${banner()}\n${file.code.trimEnd()}\n`;
      },
    },
  ],
});
