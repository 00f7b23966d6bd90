"""Bones and joints of the torso by name: 49 bones, 67 joints (paper 3.1 and 4.3).

Order is fixed, and every array with a bone or joint axis follows it. Sides are the patient's.
"""

from __future__ import annotations

from typing import NamedTuple

SIDES = ("L", "R")
THORACIC = tuple(f"T{i}" for i in range(1, 13))
LUMBAR = tuple(f"L{i}" for i in range(1, 6))
VERTEBRAE = THORACIC + LUMBAR
RIBS = tuple(f"R{i}_{side}" for i in range(1, 13) for side in SIDES)
GIRDLE = tuple(f"{bone}_{side}" for bone in ("clavicle", "scapula", "humerus") for side in SIDES)
BONES = (*VERTEBRAE, "pelvis", "sternum", *RIBS, *GIRDLE)
BONE_INDEX = {name: i for i, name in enumerate(BONES)}


class JointName(NamedTuple):
    """One joint: the bone that carries its frame, the bone that moves in it, and its row of Table 1."""

    parent: str
    child: str
    kind: str

    def __str__(self) -> str:
        return f"{self.parent}-{self.child}"


def _joints() -> tuple[JointName, ...]:
    # T12-L1 and L5-pelvis take the lumbar row (design decision, docs/errata.md).
    below = (*VERTEBRAE[1:], "pelvis")
    joints = [
        JointName(lower, upper, "thoracic" if lower in THORACIC else "lumbar") for upper, lower in zip(VERTEBRAE, below)
    ]
    joints += [JointName(f"T{i}", f"R{i}_{s}", "rib_vertebra") for i in range(1, 13) for s in SIDES]
    joints += [JointName("sternum", f"R{i}_{s}", "rib_sternum") for i in range(1, 11) for s in SIDES]
    joints += [JointName("sternum", f"clavicle_{s}", "sternum_clavicle") for s in SIDES]
    joints += [JointName(f"clavicle_{s}", f"scapula_{s}", "clavicle_scapula") for s in SIDES]
    joints += [JointName(f"scapula_{s}", f"humerus_{s}", "scapula_humerus") for s in SIDES]
    return tuple(joints)


JOINTS = _joints()
INTERVERTEBRAL = ("thoracic", "lumbar")
