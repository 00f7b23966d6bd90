// The skin as triangles: faces of six nodes are drawn with the element's own quadratic shape functions.
import { BufferAttribute, BufferGeometry } from "three";

const CUTS = 4;

export class Skin {
  readonly geometry = new BufferGeometry();
  private readonly nodes: Uint32Array;
  private readonly weights: Float32Array;
  private readonly width: number;

  constructor(faces: Uint32Array, width: number) {
    this.width = width;
    const cuts = width === 6 ? CUTS : 1;
    const known = new Map<string, number>();
    const nodes: number[] = [];
    const weights: number[] = [];
    const triangles: number[] = [];
    for (let face = 0; face * width < faces.length; face++) {
      const own = faces.subarray(face * width, (face + 1) * width);
      const vertex = (i: number, j: number): number => {
        const l = [(cuts - i - j) / cuts, i / cuts, j / cuts];
        const key = pointKey(own, l, face);
        const found = known.get(key);
        if (found !== undefined) return found;
        const number = known.size;
        known.set(key, number);
        nodes.push(...own);
        weights.push(...shape(l, width));
        return number;
      };
      for (let i = 0; i < cuts; i++) {
        for (let j = 0; i + j < cuts; j++) {
          triangles.push(vertex(i, j), vertex(i + 1, j), vertex(i, j + 1));
          if (i + j + 1 < cuts) triangles.push(vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1));
        }
      }
    }
    this.nodes = Uint32Array.from(nodes);
    this.weights = Float32Array.from(weights);
    this.geometry.setIndex(triangles);
    this.geometry.setAttribute("position", new BufferAttribute(new Float32Array(3 * known.size), 3));
  }

  /** Move the surface to these node positions. */
  place(positions: Float32Array): void {
    const attribute = this.geometry.getAttribute("position") as BufferAttribute;
    const out = attribute.array;
    out.fill(0);
    for (let k = 0; k < this.nodes.length; k++) {
      const at = 3 * Math.floor(k / this.width);
      const from = 3 * this.nodes[k]!;
      const weight = this.weights[k]!;
      for (let c = 0; c < 3; c++) out[at + c]! += weight * positions[from + c]!;
    }
    attribute.needsUpdate = true;
    this.geometry.computeVertexNormals();
    this.geometry.computeBoundingSphere();
  }
}

/** The same for the same point of neighbouring faces: a corner, or a place on the edge between two corners. */
function pointKey(nodes: Uint32Array, l: number[], face: number): string {
  const on = [0, 1, 2].filter((i) => l[i]! > 0);
  if (on.length === 3) return `${face}:${l}`;
  const named = on.map((i): [number, number] => [nodes[i]!, l[i]!]).sort((a, b) => a[0] - b[0]);
  return named.map(([node, share]) => `${node}@${share}`).join("|");
}

function shape(l: number[], width: number): number[] {
  if (width === 3) return l;
  const [a, b, c] = l as [number, number, number];
  return [a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a];
}
