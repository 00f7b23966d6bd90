// The torso itself: bones, skin, joints, and the spine where it was at rest.
import {
  BackSide,
  BufferAttribute,
  BufferGeometry,
  FrontSide,
  Group,
  InstancedMesh,
  Matrix4,
  Mesh,
  MeshLambertMaterial,
  type Side,
  SphereGeometry,
  Vector3,
} from "three";
import { toCreasedNormals } from "three/examples/jsm/utils/BufferGeometryUtils.js";
import type { Palette } from "./palette";
import { onBone, type Pose } from "./pose";
import type { Scene } from "./scene";
import { Skin } from "./skin";

const CREASE = (50 * Math.PI) / 180;
const JOINT_RADIUS = 3.2;

export class Body {
  readonly bones = new Group();
  readonly skin = new Group();
  readonly joints: InstancedMesh;
  readonly rest = new Group();
  private readonly meshes: Mesh[] = [];
  private readonly surface: Skin;
  private readonly boneMaterial = new MeshLambertMaterial();
  private readonly restMaterial = new MeshLambertMaterial({ transparent: true, opacity: 0.38, depthWrite: false });
  private readonly jointMaterial = new MeshLambertMaterial({ transparent: true, depthTest: false });
  private readonly skinMaterials = [skinMaterial(BackSide, 0.3), skinMaterial(FrontSide, 0.42)];
  private readonly scene: Scene;

  constructor(scene: Scene, rest: Pose) {
    this.scene = scene;
    for (const [i, geometry] of boneGeometries(scene).entries()) {
      const mesh = new Mesh(geometry, this.boneMaterial);
      this.meshes.push(mesh);
      this.bones.add(mesh);
      if (scene.bones[i]!.kind === "vertebra") {
        const ghost = new Mesh(geometry, this.restMaterial);
        ghost.position.copy(rest.places[i]!);
        ghost.quaternion.copy(rest.turns[i]!);
        this.rest.add(ghost);
      }
    }
    this.surface = new Skin(scene.skinFaces, scene.skinWidth);
    this.skinMaterials.forEach((material, i) => {
      const mesh = new Mesh(this.surface.geometry, material);
      // What lies behind is blended first.
      mesh.renderOrder = 1 + i;
      this.skin.add(mesh);
    });
    const count = scene.joints.bone.length;
    this.joints = new InstancedMesh(new SphereGeometry(JOINT_RADIUS, 14, 10), this.jointMaterial, count);
    this.joints.frustumCulled = false;
    this.joints.renderOrder = 3;
    this.place(rest);
  }

  place(pose: Pose): void {
    this.meshes.forEach((mesh, i) => {
      mesh.position.copy(pose.places[i]!);
      mesh.quaternion.copy(pose.turns[i]!);
    });
    this.surface.place(pose.skin);
    const matrix = new Matrix4();
    this.scene.joints.bone.forEach((bone, i) => {
      const offset = new Vector3().fromArray(this.scene.joints.offset, 3 * i);
      this.joints.setMatrixAt(i, matrix.setPosition(onBone(pose, bone, offset)));
    });
    this.joints.instanceMatrix.needsUpdate = true;
  }

  paint(palette: Palette): void {
    this.boneMaterial.color.copy(palette.bone);
    this.restMaterial.color.copy(palette.rest);
    this.jointMaterial.color.copy(palette.joint);
    for (const material of this.skinMaterials) material.color.copy(palette.skin);
  }
}

function boneGeometries(scene: Scene): BufferGeometry[] {
  let vertex = 0;
  let face = 0;
  return scene.bones.map((bone) => {
    const geometry = new BufferGeometry();
    const points = scene.vertices.subarray(3 * vertex, 3 * (vertex + bone.vertices));
    geometry.setAttribute("position", new BufferAttribute(points, 3));
    geometry.setIndex(new BufferAttribute(scene.faces.subarray(3 * face, 3 * (face + bone.faces)), 1));
    vertex += bone.vertices;
    face += bone.faces;
    return bone.faces ? toCreasedNormals(geometry, CREASE) : geometry;
  });
}

/** See-through, but less so where the surface turns away: its outline shows, what lies inside as well. */
function skinMaterial(side: Side, opacity: number): MeshLambertMaterial {
  const material = new MeshLambertMaterial({ side, transparent: true, opacity, depthWrite: false });
  material.onBeforeCompile = (shader) => {
    shader.fragmentShader = shader.fragmentShader.replace(
      "#include <opaque_fragment>",
      `float turned = 1.0 - abs(dot(normalize(normal), normalize(vViewPosition)));
       diffuseColor.a *= mix(0.28, 1.0, turned * turned);
       #include <opaque_fragment>`,
    );
  };
  return material;
}

