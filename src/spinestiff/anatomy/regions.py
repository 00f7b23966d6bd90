"""Stiffness parameters of a part of the torso by name: a region of the spine, one level, the thorax or the abdomen.

A name is ``group@part``: a group of ``stiffness.parameter_group`` and where it is taken. Ratios of overlapping groups
multiply, so that "lateral_bending" beside "lateral_bending@lumbar" is an overall ratio and a lumbar one relative to it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from spinestiff.anatomy.names import RIBS, VERTEBRAE
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.stiffness import (
    KINDS,
    TISSUE_PARAMETERS,
    ParameterGroup,
    StiffnessRatios,
    parameter_group,
)
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints
from spinestiff.errors import TorsoError

AT = "@"
# The vertebrae between which the levels lie, from above downward; the sacrum is a part of the pelvis.
CHAIN = (*VERTEBRAE, "S1")
# As Table 1's rows are taken: T12-L1 is lumbar (docs/errata.md).
SPINE_REGIONS = {"thoracic": ("T1", "T12"), "lumbar": ("T12", "S1")}
# Every level a ratio of its own.
LEVELS = "levels"
# Tissue above and below the height of the joint between T12 and L1.
TISSUE_REGIONS = ("thorax", "abdomen")
_WANTED = {
    True: f"wanted one of {', '.join(TISSUE_REGIONS)}",
    False: f"wanted one of {', '.join(SPINE_REGIONS)}, {LEVELS}, or two vertebrae from T1 to S1, the upper one first, "
    "such as T8-T9",
}


def check_parameters(names: Sequence[str]) -> None:
    """Whether parameters of these names can be asked of a torso.

    Raises
    ------
    TorsoError : none, one twice, or an unknown group or part.
    """
    if not names:
        raise TorsoError("no stiffness parameter; wanted at least one")
    for name in names:
        if names.count(name) > 1:
            raise TorsoError(f"stiffness parameter '{name}' is named twice")
        group, part = _parts(name)
        if group.mu or group.lambda_ or not part:
            continue
        if not (levels_of(name) or part == LEVELS):
            raise TorsoError(f"unknown part '{part}' in '{name}'; {_WANTED[False]}")


def check_ratios(names: Sequence[str]) -> None:
    """Whether ratios of these names, a value each, can be put into a torso.

    Raises
    ------
    TorsoError : as ``check_parameters``; one value for each level.
    """
    check_parameters(names)
    for name in names:
        stem, _, part = name.partition(AT)
        if part == LEVELS:
            raise TorsoError(f"'{name}' is a ratio for each level; wanted the levels by name, such as {stem}{AT}T8-T9")


def expanded(torso: TorsoModel, names: Sequence[str]) -> tuple[str, ...]:
    """The names with each ``group@levels`` as one name a level of the torso, from above downward."""
    check_parameters(names)
    found: list[str] = []
    for name in names:
        stem, _, part = name.partition(AT)
        if part != LEVELS:
            found.append(name)
            continue
        there = set(joint_levels(torso)[parameter_group(stem, torso.joints.kinds).joints.any(axis=1)].tolist()) - {-1}
        if not there:
            raise TorsoError(f"'{stem}' has no joints at the levels of the spine")
        found += [f"{stem}{AT}{CHAIN[level]}-{CHAIN[level + 1]}" for level in sorted(there)]
    check_parameters(found)
    return tuple(found)


def parameter_groups(torso: TorsoModel, names: Sequence[str]) -> tuple[ParameterGroup, ...]:
    """The groups of ``expanded`` names on a torso.

    At a part of the spine a group has its joints at these levels. A rib is of the level above the vertebra of its
    number, whose disc it meets (the first of T1-T2), and takes its sternal joint along. So all levels together have
    every joint of the group, each once.

    Raises
    ------
    TorsoError : as ``check_parameters``; the torso has nothing of a group at its part; two groups are the same, so that
        only the product of their ratios could be told.
    """
    groups = tuple(_group(torso, name) for name in expanded(torso, names))
    known: dict[tuple[bytes | bool, ...], str] = {}
    for group in groups:
        elements = group.elements_of(len(torso.tissue.elements)) if group.mu or group.lambda_ else np.zeros(0, bool)
        same = known.setdefault((group.joints.tobytes(), group.mu, group.lambda_, elements.tobytes()), group.name)
        if same != group.name:
            raise TorsoError(f"'{same}' and '{group.name}' scale the same stiffnesses of this torso; leave one out")
    return groups


def torso_ratios(torso: TorsoModel, ratios: Mapping[str, float]) -> StiffnessRatios:
    """Ratios by name, for this torso. Raises TorsoError as ``check_ratios`` and ``parameter_groups``."""
    check_ratios(tuple(ratios))
    groups = tuple(_group(torso, name) for name in ratios)
    return StiffnessRatios(groups, np.array(list(ratios.values()), dtype=float))


def scaled_torso(torso: TorsoModel, ratios: Mapping[str, float]) -> TorsoModel:
    """The torso with its stiffness times these ratios. Raises TorsoError as ``torso_ratios``."""
    found = torso_ratios(torso, ratios)
    mu, lambda_ = found.scale_tissue(torso.tissue.lame_mu, torso.tissue.lame_lambda)
    return replace(
        torso,
        joints=replace(torso.joints, stiffness=found.scale_joints(torso.joints.stiffness)),
        tissue=replace(torso.tissue, lame_mu=mu, lame_lambda=lambda_),
    )


def levels_of(name: str) -> tuple[int, ...]:
    """Indices of the levels (0 is T1-T2, 16 is L5-S1) that a name's part of the spine has; () where it has none."""
    part = name.partition(AT)[2]
    upper, _, lower = part.partition("-")
    first, last = SPINE_REGIONS.get(part, (upper, lower))
    if first not in CHAIN or last not in CHAIN:
        return ()
    return tuple(range(CHAIN.index(first), CHAIN.index(last)))


def joint_levels(torso: TorsoModel) -> Ints:
    """(J,) the level of each joint, -1 for those of the shoulder girdle and of bones with other names.

    A joint of a rib with a scapula (``template.options``) is of the rib's level, as all of a rib's.
    """
    found = np.full(len(torso.joints), -1, dtype=np.int64)
    chain = (*VERTEBRAE, "pelvis")
    for i, ends in enumerate(zip(torso.joints.parent.tolist(), torso.joints.child.tolist())):
        bones = {torso.bone_names[end] for end in ends}
        ribs, spine = bones & set(RIBS), bones & set(chain)
        if ribs:
            number = int(min(ribs)[1:].partition("_")[0])
            found[i] = max(number - 2, 0)
        elif len(spine) == 2:
            upper, lower = sorted(chain.index(name) for name in spine)
            found[i] = upper if lower == upper + 1 else -1
    return found


def element_heights(torso: TorsoModel) -> Floats:
    """(T,) mm, of the tissue elements' centres at rest above the joint between T12 and L1."""
    joints = torso.joints
    ends = [{torso.bone_names[bone] for bone in pair} for pair in zip(joints.parent.tolist(), joints.child.tolist())]
    if {"T12", "L1"} not in ends:
        raise TorsoError(f"no joint between T12 and L1 in this torso, which parts {' from '.join(TISSUE_REGIONS)}")
    at = ends.index({"T12", "L1"})
    height = PointsOnBones(joints.parent[[at]], joints.parent_position[[at]]).positions(torso.rest_pose)[0, 1]
    corners = torso.tissue.rest_positions[torso.tissue.elements[:, :4]]
    return np.asarray(corners[..., 1].mean(axis=1) - height)


def is_beside_whole(name: str, parameters: Sequence[str]) -> bool:
    """Whether a ratio is of a part whose whole has one among ``parameters``, too: then it is relative to that one."""
    whole = name.partition(AT)[0]
    return name != whole and whole in parameters


def _parts(name: str) -> tuple[ParameterGroup, str]:
    """The group of all joints of a torso, and the part's name; "" without one. Raises TorsoError."""
    stem, at, part = name.partition(AT)
    group = parameter_group(stem, KINDS)
    of_tissue = group.mu or group.lambda_
    if at and of_tissue and group.joints.any():
        raise TorsoError(f"'{name}': '{stem}' is of joints and tissue, a part is of one of them")
    if at and (not part or (of_tissue and part not in TISSUE_REGIONS)):
        raise TorsoError(f"unknown part '{part}' in '{name}'; {_WANTED[stem in TISSUE_PARAMETERS]}")
    return group, part


def _group(torso: TorsoModel, name: str) -> ParameterGroup:
    check_parameters([name])
    stem, _, part = name.partition(AT)
    whole = parameter_group(stem, torso.joints.kinds)
    if not part:
        return whole
    if part in TISSUE_REGIONS:
        heights = element_heights(torso)
        found = whole.within(name, elements=heights >= 0.0 if part == "thorax" else heights < 0.0)
        empty = found.elements is None or not found.elements.any()
    else:
        found = whole.within(name, joints=np.isin(joint_levels(torso), levels_of(name)))
        empty = not found.joints.any()
    if empty:
        raise TorsoError(f"'{name}': the torso has nothing of '{stem}' at {part}")
    return found
