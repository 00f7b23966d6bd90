"""Slicer markups: joints, landmarks and the corners of vertebral bodies as named points, in LPS."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from spinestiff.anatomy.names import RIBS
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats

_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)


def lps_from_world(points: Floats) -> Floats:
    """Points (..., 3) of the world (left, up, front) in DICOM's and Slicer's axes (left, posterior, superior)."""
    points = np.asarray(points)
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], -1)


def content(torso: TorsoModel, state: TorsoState) -> bytes:
    """The file: one list of points each for joints, landmarks and vertebral bodies."""
    joints = PointsOnBones(torso.joints.parent, torso.joints.parent_position).positions(state)
    lists = [point_list("joints", list(torso.joints.names), lps_from_world(joints))]
    names, places = [], []
    for key, points in sorted(torso.landmarks.items()):
        at = points.positions(state)
        labels = RIBS if key == "rib_lateral" and len(at) == len(RIBS) else tuple(str(i + 1) for i in range(len(at)))
        names += [f"{key} {label}" for label in labels]
        places.append(at)
    if places:
        lists.append(point_list("landmarks", names, lps_from_world(np.vstack(places))))
    bones = torso.vertebra_bones
    corners = np.einsum("vij,vkj->vki", state.bone_rotations[bones], torso.vertebra_boxes)
    corners = corners + state.bone_positions[bones][:, None]
    # The order of ``TorsoModel.vertebra_boxes``.
    ends = [
        f"{a}-{b}-{c}" for a in ("superior", "inferior") for b in ("left", "right") for c in ("anterior", "posterior")
    ]
    names = [f"{vertebra} {end}" for vertebra in torso.vertebrae for end in ends]
    if names:
        lists.append(point_list("vertebral bodies", names, lps_from_world(corners.reshape(-1, 3))))
    return document(lists)


def document(lists: list[dict[str, Any]]) -> bytes:
    """A markups file of these lists of points."""
    return json.dumps({"@schema": _SCHEMA, "markups": lists}, indent=1).encode()


def point_list(title: str, labels: list[str], lps: Floats) -> dict[str, Any]:
    """One list of named points (n, 3) in LPS, mm, that the mouse does not move."""
    points = [
        {
            "id": str(i + 1),
            "label": label,
            "position": [round(float(v), 4) for v in place],
            "selected": True,
            "locked": True,
            "visibility": True,
            "positionStatus": "defined",
        }
        for i, (label, place) in enumerate(zip(labels, lps))
    ]
    return {
        "type": "Fiducial",
        "name": title,
        "coordinateSystem": "LPS",
        "coordinateUnits": "mm",
        "locked": True,
        "labelFormat": "%N-%d",
        "controlPoints": points,
    }
