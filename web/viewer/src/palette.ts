// Colours come from the page's style sheet, so that light, dark and print agree with the legend.
import { Color } from "three";

export const COLOURS = ["bone", "skin", "joint", "load", "support", "measured", "simulated", "rest"] as const;
export type Palette = Record<(typeof COLOURS)[number], Color>;

export function readPalette(root: HTMLElement): Palette {
  const style = getComputedStyle(root);
  const entries = COLOURS.map((name) => [name, new Color(style.getPropertyValue(`--v-${name}`).trim() || "#888888")]);
  return Object.fromEntries(entries) as Palette;
}
