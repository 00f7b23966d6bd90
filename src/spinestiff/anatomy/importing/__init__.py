"""A torso from a person's own bone meshes: read, named, oriented, repaired, joined and meshed"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spinestiff.anatomy.importing.carried_skin import generated_skin, refuse_bones_outside, section_middle
from spinestiff.anatomy.importing.naming import HEIGHTS_CM, BoneFiles, find_files
from spinestiff.anatomy.importing.orienting import Placement, find_placement, refuse_large_skin
from spinestiff.anatomy.importing.placing import Skeleton, landmarks, place_joints, rest_frames, template_column_mm
from spinestiff.anatomy.importing.reading import read_surface
from spinestiff.anatomy.importing.repairing import repaired
from spinestiff.anatomy.meshing import (
    DEFAULT_MESHER,
    SKIN_SHARE,
    MeshedTissue,
    find_mesher,
    mesh_tissue,
    refuse_spacing,
    refuse_unknown_mesher,
)
from spinestiff.anatomy.names import BONE_INDEX, BONES, JOINTS
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rounding import rounded
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import DEFAULT_POISSON, DEFAULT_YOUNG_MPA, KINDS, joint_stiffness, lame_parameters
from spinestiff.anatomy.template.surfaces import Surface, joined, signed_volume
from spinestiff.anatomy.torso import BoneSurface, JointTable, TissueMesh, TorsoModel, joint_frames
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.errors import TorsoError
from spinestiff.observer import Observer, heard

__all__ = ["DEFAULT_SPACING_MM", "ImportedTorso", "import_torso"]

DEFAULT_SPACING_MM = 28.0
TEMPLATE_HEIGHT_CM = 157.0
WORTH_TELLING = 0.1  # of a stated height against that of the spine's length
MOST_UNLIKE = 1.5  # of a stated height and that of the spine's length; an inch is 2.54 cm


@dataclass(frozen=True, repr=False)
class ImportedTorso(ShortRepr):
    """A torso of one's own bones and how it came about.

    Attributes
    ----------
    torso : the model.
    files : names of the files of each bone, and of the skin (None: generated).
    placement : unit and axes, found or told.
    repairs : what was repaired, a line each, naming the mesh.
    notes : what else a person should know, e.g. gaps at joints, an estimated height.
    tissue : the mesh and its quality.
    """

    torso: TorsoModel
    files: BoneFiles
    placement: Placement
    repairs: tuple[str, ...]
    notes: tuple[str, ...]
    tissue: MeshedTissue


def import_torso(
    folder: str | Path,
    *,
    mapping: str | Path | None = None,
    unit: str | None = None,
    axes: str | None = None,
    skin: str | Path | None = None,
    spacing_mm: float = DEFAULT_SPACING_MM,
    height_cm: float | None = None,
    mesher: str = DEFAULT_MESHER,
    observer: Observer | None = None,
) -> ImportedTorso:
    """A torso from a folder of bone meshes (STL, OBJ, PLY, VTP), one bone a file or in parts.

    Parameters
    ----------
    folder : the meshes; files by name (docs/your-own-anatomy.md), or as ``mapping`` (a JSON file) says.
    unit : "mm", "cm" or "m"; found by the bones' size if left out. A unit that contradicts the bones is refused.
    axes : three letters, where the files' x, y and z point, e.g. "LPS"; found by the bones' places if left out.
    skin : a closed mesh in the same unit and axes; generated around the bones if left out.
    spacing_mm : wanted distance of the tissue mesh's corners.
    height_cm : body height; estimated from the spine's length if left out.
    mesher : "mmg" (extra [mesh]), or a plug-in's name. Whether it is installed is asked when all bones and the skin are
        in order: what they lack is told first.
    observer : is told what is being done, in words.

    Raises
    ------
    TorsoError : in one line, naming the mesh, what can't be used and what to do.
    """
    say = heard(observer, logging.getLogger(__name__))
    refuse_unknown_mesher(mesher)
    refuse_spacing(spacing_mm)
    try:
        find_mesher(mesher)
    except TorsoError as lack:
        say(f"note: {lack}; until then the bones are checked, and no torso is made")
    files = find_files(Path(folder), *(None if path is None else Path(path) for path in (mapping, skin)))
    say(f"read: {sum(map(len, files.bones.values()))} meshes")
    raw = {name: [(path.name, read_surface(path)) for path in files.bones[name]] for name in BONES}
    _refuse_copies(raw)
    whole = {name: joined(*(surface for _, surface in parts)) for name, parts in raw.items()}
    placement = find_placement(whole, unit or files.unit, axes or files.axes)
    say(f"axes: {placement}")
    outer = None if files.skin is None else (files.skin.name, read_surface(files.skin))
    if outer is not None:
        refuse_large_skin(*outer, whole)
    matrix = placement.world_from_file
    repairs: list[str] = []

    def clean(name: str, surface: Surface) -> Surface:
        fixed, lines = repaired(name, (surface[0] @ matrix.T, surface[1]))
        repairs.extend(lines)
        return fixed

    say("repair: holes, turned and repeated triangles")
    surfaces = {name: joined(*(clean(file, surface) for file, surface in raw[name])) for name in BONES}
    given = None if outer is None else clean(*outer)
    say("joints: measuring vertebrae and ribs")
    skeleton, origin = place_joints(surfaces)
    notes = list(skeleton.notes)
    height = height_cm if height_cm is not None else files.height_cm
    scale = skeleton.column_mm / template_column_mm()
    usual = scale * TEMPLATE_HEIGHT_CM
    if height is None:
        height = usual
        notes.append(
            f"body height {height:.0f} cm estimated from the spine's {skeleton.column_mm:.0f} mm; --height overrides it"
        )
    if not HEIGHTS_CM[0] <= height <= HEIGHTS_CM[1]:
        raise TorsoError(f"body height {height:.0f} cm; wanted {HEIGHTS_CM[0]:g} to {HEIGHTS_CM[1]:g} cm")
    if not 1.0 / MOST_UNLIKE < height / usual < MOST_UNLIKE:
        raise TorsoError(
            f"body height {height:.0f} cm, but a spine of {skeleton.column_mm:.0f} mm goes with some {usual:.0f} cm; "
            "check the height and the files' unit, which may be none of mm, cm and m"
        )
    if abs(height / usual - 1.0) > WORTH_TELLING:
        notes.append(
            f"body height {height:.0f} cm as told, but a spine of {skeleton.column_mm:.0f} mm goes with some "
            f"{usual:.0f} cm"
        )
    say("skin: generating one" if given is None else "skin: checking that all bones lie inside")
    closed = None if given is None else (given[0] - origin, given[1])
    if closed is not None and (smooth := rounded(closed, SKIN_SHARE * spacing_mm)) is not closed:
        notes.append(
            f"the skin's {len(closed[1])} large, flat triangles were rounded to mesh under them; its volume changed by "
            f"{100.0 * (signed_volume(smooth) / signed_volume(closed) - 1.0):+.1f} %"
        )
        closed = smooth
    rest, points, closed = _frames(skeleton, closed, scale)
    refuse_bones_outside(skeleton.surfaces, closed)
    tissue = mesh_tissue(skeleton.surfaces, closed, spacing_mm, mesher, observer)
    torso = _assembled(skeleton, rest, points, tissue, float(height))
    return ImportedTorso(torso, files, placement, tuple(repairs), tuple(notes), tissue)


def _refuse_copies(raw: Mapping[str, list[tuple[str, Surface]]]) -> None:
    # The same mesh under two names: one of the two bones is missing in truth.
    seen: dict[tuple[int, bytes], str] = {}
    for parts in raw.values():
        for name, (vertices, faces) in parts:
            # What a bone is made of, whatever the order of its triangles.
            corners = vertices[faces].reshape(-1, 3)
            key = (len(faces), np.sort(corners.astype(np.float32), axis=0).tobytes())
            if key in seen:
                raise TorsoError(f"{seen[key]} and {name} are the same mesh under two names")
            seen[key] = name


def _frames(
    skeleton: Skeleton, skin: Surface | None, scale: float
) -> tuple[TorsoState, dict[str, PointsOnBones], Surface]:
    # Rest frames, landmarks and skin. The pelvis' origin, on the belt's axis, depends on the skin, and a generated skin
    # on the landmarks: first with the pelvis' own middle.
    vertices = skeleton.surfaces["pelvis"][0]
    pelvis = 0.5 * (vertices.min(0) + vertices.max(0))
    none = np.zeros((0, 3))
    if skin is None:
        rest = TorsoState(*rest_frames(skeleton, pelvis), none)
        skin = generated_skin(skeleton, rest, landmarks(skeleton, rest), scale)
    origin = np.array([pelvis[0], pelvis[1], section_middle(skin, float(pelvis[1]))])
    rest = TorsoState(*rest_frames(skeleton, origin), none)
    return rest, landmarks(skeleton, rest), skin


def _assembled(
    skeleton: Skeleton, rest: TorsoState, points: Mapping[str, PointsOnBones], tissue: MeshedTissue, height: float
) -> TorsoModel:
    mu, lambda_ = (np.full(len(tissue.elements), v) for v in lame_parameters(DEFAULT_YOUNG_MPA, DEFAULT_POISSON))
    parent = np.array([BONE_INDEX[joint.parent] for joint in JOINTS])
    child = np.array([BONE_INDEX[joint.child] for joint in JOINTS])
    frames = joint_frames(rest, parent, child, skeleton.centres, skeleton.axes)
    free: Floats = tissue.nodes[tissue.bone_of_node < 0]
    surfaces = tuple(
        BoneSurface(
            (skeleton.surfaces[name][0] - rest.bone_positions[i]) @ rest.bone_rotations[i], skeleton.surfaces[name][1]
        )
        for i, name in enumerate(BONES)
    )
    return TorsoModel(
        bone_names=BONES,
        rest_pose=TorsoState(rest.bone_positions, rest.bone_rotations, free),
        joints=JointTable(
            names=tuple(str(joint) for joint in JOINTS), kinds=KINDS, parent=parent, child=child,
            stiffness=joint_stiffness(), **frames,
        ),
        tissue=TissueMesh(tissue.nodes, tissue.elements, tissue.bone_of_node, mu, lambda_),
        vertebra_boxes=np.array([vertebra.box for vertebra in skeleton.vertebrae.values()]),
        bone_surfaces=surfaces,
        landmarks=dict(points),
        height_cm=height,
    )  # fmt: skip
