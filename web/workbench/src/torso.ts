// A small torso from the front, as a radiograph shows it: what a value of a push means, with the value itself.
import { svg } from "../../shared/dom";

export interface Push { side: "left" | "right" | null; level: number | null; d21: number | null; d31: number | null; force: number | null }
const TOP = 66, RIB = 13.5, MIDDLE = 150, PELVIS = 292, SHOULDER = 62;
const rib = (level: number): number => TOP + 14 + RIB * (level - 1);

/** The picture; ``focus`` is the value that is being filled in. */
export function torso(push: Push, focus: string): SVGElement {
  const side = push.side ?? "right", level = push.level ?? 8, from = side === "right" ? -1 : 1, y = rib(level), away = -from;
  const at = (x: number): number => MIDDLE + x;
  const mark = (name: string): string => (focus === name ? "t-on" : "t-off");
  // Its words stand outside of its line, in a column that nothing else enters, however long they are.
  const dimension = (name: string, x: number, low: number, words: string): SVGElement => svg("g", { class: `t-size ${mark(name)}` },
    svg("path", { d: `M${at(x - 5)} ${SHOULDER}h10M${at(x - 5)} ${low}h10M${at(x)} ${SHOULDER}V${low}` }),
    svg("path", { class: "t-head", d: `M${at(x)} ${SHOULDER}l-3.5 8h7zM${at(x)} ${low}l-3.5 -8h7z` }),
    svg("text", { "text-anchor": "middle", "dominant-baseline": "central", transform: `translate(${at(x + 15 * away)} ${(SHOULDER + low) / 2}) rotate(-90)` }, words));
  const ribs = Array.from({ length: 12 }, (_, i) => {
    const half = [36, 46, 54, 60, 64, 66, 67, 67, 65, 62, 50, 38][i] ?? 50, here = rib(i + 1), chosen = Math.abs(i + 1 - level) < 0.51;
    return svg("path", { class: chosen && push.level !== null ? `t-rib t-chosen ${mark("level")}` : "t-rib", d: `M${at(-half)} ${here + 4}Q${at(-half / 2)} ${here - 9} ${MIDDLE} ${here}Q${at(half / 2)} ${here - 9} ${at(half)} ${here + 4}` });
  });
  const size = (value: number | null, name: string): string => (value === null ? `${name} ?` : `${name} ${value} mm`);
  const tip = at(from * 70), start = at(from * 122);
  return svg("svg", { viewBox: "-10 0 320 340", class: "torso", role: "img", "aria-label": `A torso from the front. The push comes from the patient's ${side} at rib ${level}; d21 runs from the shoulder support down to the pelvis support, d31 from the shoulder support down to the push.` },
    svg("path", { class: "t-skin", d: "M128 20C128 44 122 50 104 54C84 58 74 66 74 92C76 150 84 190 86 214C80 246 74 268 74 300H226C226 268 220 246 214 214C216 190 224 150 226 92C226 66 216 58 196 54C178 50 172 44 172 20Z" }),
    ...ribs,
    svg("path", { class: "t-spine", d: `M${MIDDLE} 40C${MIDDLE + from * 2} 100 ${MIDDLE + from * 16} ${y - 20} ${MIDDLE + from * 13} ${y}S${MIDDLE} 240 ${MIDDLE} 276` }),
    svg("path", { class: "t-pelvis", d: "M104 284Q150 268 196 284Q192 306 150 310Q108 306 104 284Z" }),
    svg("g", { class: `t-support ${mark("side")}` },
      svg("rect", { x: at(away * 84) - 7, y: SHOULDER - 13, width: 14, height: 26, rx: 3 }), svg("rect", { x: at(away * 84) - 7, y: PELVIS - 13, width: 14, height: 26, rx: 3 })),
    svg("g", { class: `t-push ${focus === "force" || focus === "side" || focus === "level" ? "t-on" : "t-off"}` },
      svg("path", { d: `M${start} ${y}H${tip}` }), svg("path", { class: "t-head", d: `M${tip} ${y}l${from * 11} -6v12z` }),
      svg("text", { x: at(from * 84), y: y - 11, "text-anchor": from < 0 ? "end" : "start" }, !push.force ? "push" : `${push.force} N`)),
    dimension("d31", away * 100, y, size(push.d31, "d31")), dimension("d21", away * 129, PELVIS, size(push.d21, "d21")),
    svg("text", { class: "t-side", x: 12, y: 330 }, "patient’s right"), svg("text", { class: "t-side", x: 288, y: 330, "text-anchor": "end" }, "patient’s left"));
}
