// The way of the rays, from above: which distances the source, the patient and the detector have, with their values.
import { svg } from "../../shared/dom";

export interface Beam { detector: number | null; patient: number | null; pixel: number | null; object: number | null; onDetector: boolean; shown: boolean }
const SOURCE = 24, PATIENT = 208, DETECTOR = 276, AXIS = 62;

/** The picture; ``focus`` is the value that is being filled in. */
export function beam(of: Beam, focus: string): SVGElement {
  const mark = (name: string): string => (focus === name ? "t-on" : "t-off");
  const size = (value: number | null, words: string): string => (value === null ? `${words} ?` : `${words} ${value} mm`);
  const dimension = (name: string, end: number, y: number, words: string): SVGElement => svg("g", { class: `t-size ${mark(name)}` },
    svg("path", { d: `M${SOURCE} ${y - 5}v10M${end} ${y - 5}v10M${SOURCE} ${y}H${end}` }),
    svg("path", { class: "t-head", d: `M${SOURCE} ${y}l8 -3.5v7zM${end} ${y}l-8 -3.5v7z` }),
    svg("text", { "text-anchor": "middle", x: (SOURCE + end) / 2, y: y + 15 }, words));
  return svg("svg", { viewBox: "-10 0 320 200", class: "torso beam", role: "img", "aria-label": "The way of the rays from above: from the source through the patient to the detector. The distance to the patient ends at the middle of the spine, that to the detector at its plane." },
    svg("path", { class: "t-skin", d: `M${SOURCE} ${AXIS}L${DETECTOR} ${AXIS - 46}V${AXIS + 46}Z` }),
    svg("ellipse", { class: "t-pelvis", cx: PATIENT, cy: AXIS, rx: 24, ry: 32 }),
    svg("circle", { class: "t-spine", cx: PATIENT, cy: AXIS, r: 5 }), svg("circle", { class: "t-spine", cx: SOURCE, cy: AXIS, r: 4 }),
    svg("g", { class: `t-size ${mark("pixel")}` }, svg("path", { d: `M${DETECTOR} ${AXIS - 46}V${AXIS + 46}` }),
      svg("text", { x: 302, y: AXIS - 50, "text-anchor": "end" }, size(of.pixel, "pixel"))),
    of.shown && svg("g", { class: `t-size ${mark("object")}` }, svg("path", { d: `M${of.onDetector ? DETECTOR - 4 : PATIENT} ${AXIS - 30}v16m-4 0h8m-8 -16h8` }),
      svg("text", { x: (of.onDetector ? DETECTOR - 4 : PATIENT) - 8, y: AXIS - 18, "text-anchor": "end" }, size(of.object, "object"))),
    svg("text", { class: "t-side", x: SOURCE - 8, y: AXIS - 12 }, "source"), svg("text", { class: "t-side", x: PATIENT, y: AXIS - 38, "text-anchor": "middle" }, "patient"),
    dimension("source_patient", PATIENT, AXIS + 62, size(of.patient, "to the patient")), dimension("source_detector", DETECTOR, AXIS + 100, size(of.detector, "to the detector")));
}
