// How each page's script is built: minified, classic, with the hash of its sources at its head, its page and style sheet beside it.
import { createHash } from "node:crypto";
import { copyFileSync, existsSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { basename, join } from "node:path";

interface Given {
  /** The folder of the sources. */
  here: string;
  /** Where what is built goes, from there. */
  out: string;
  /** More words at the head, as licences of what is built in. */
  head?: string[];
  /** What the style sheet is made of, from the folder of the sources; none without. */
  styles?: string[];
}

/** The same list is read by tests/built.py. */
function sourceHash(here: string): string {
  const names = ["index.html", "package.json", "package-lock.json", "tsconfig.json", "vite.config.ts"].filter((name) => existsSync(join(here, name)));
  for (const folder of ["src", "../shared"]) for (const name of readdirSync(join(here, folder))) names.push(`${folder}/${name}`);
  const digest = createHash("sha256");
  for (const name of names.sort()) {
    digest.update(`${name}\n`).update(readFileSync(join(here, name), "utf8").replaceAll("\r\n", "\n"));
  }
  return digest.digest("hex");
}

export function built({ here, out, head = [], styles = [] }: Given) {
  const name = basename(here), place = join(here, out);
  const first = [`/*! spinestiff ${name}, Apache-2.0; built from web/${name}, do not edit.`, `sources sha256 ${sourceHash(here)}`, ...head, "*/"].join("\n");
  return {
    build: {
      target: "es2022",
      outDir: place,
      emptyOutDir: false,
      copyPublicDir: false,
      lib: { entry: join(here, "src/main.ts"), formats: ["iife" as const], name: `spinestiff${name}`, fileName: () => `${name}.js` },
    },
    plugins: [
      {
        // After the minifier, which drops comments.
        name: "head",
        generateBundle(_: unknown, bundle: Record<string, { type: string; code?: string }>): void {
          for (const file of Object.values(bundle)) if (file.type === "chunk") file.code = `${first}\n${(file.code ?? "").trimEnd()}\n`;
        },
        closeBundle(): void {
          if (existsSync(join(here, "index.html"))) copyFileSync(join(here, "index.html"), join(place, "index.html"));
          if (styles.length) writeFileSync(join(place, `${name}.css`), styles.map((one) => readFileSync(join(here, one), "utf8")).join(""));
        },
      },
    ],
  };
}
