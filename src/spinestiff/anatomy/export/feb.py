"""FEBio 4, through pyfebio (extra [febio]): tissue, bones as rigid shells with tissue nodes tied to them, springs."""

from __future__ import annotations

from typing import Any

import numpy as np

from spinestiff.anatomy.export.rigid import require_rest
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import TorsoError

ARM_MM = 50.0  # of the couples that stand for a joint's turning springs; longer where translation is soft
HALF_MM = 10.0  # half the length of a spring
_SHELL_MM = 0.1


def springs_of_joint(stiffness: Floats) -> tuple[Floats, Floats, Floats]:
    """Springs along lines that together have a joint's stiffness (6,) at rest.

    Three lie through the joint's centre, along its axes; for each turn there are two more, along one axis and a lever
    away on another, which resist the turn as a couple. What these six add along the axes, the first three lack.

    Returns
    -------
    middle (9, 3) mm and unit direction (9, 3) in the joint's frame, and stiffness (9,) N/mm.
    """
    along, turning = stiffness[:3], stiffness[3:]
    arm = ARM_MM
    while True:
        left, middle, direction, values = along.astype(float), [], [], []
        for axis in range(3):
            # Along the stiffer of the two axes across.
            a, b = (axis + 1) % 3, (axis + 2) % 3
            line, lever = (a, b) if along[a] >= along[b] else (b, a)
            each = float(turning[axis]) / (2.0 * arm**2)
            left[line] -= 2.0 * each
            for sign in (1.0, -1.0):
                middle.append(sign * arm * np.eye(3)[lever])
                direction.append(np.eye(3)[line])
                values.append(each)
        if (left >= 0.0).all() or arm > 1e4:
            break
        arm *= 1.25
    middle = [*np.zeros((3, 3)), *middle]
    return np.array(middle), np.array([*np.eye(3), *direction]), np.array([*np.maximum(left, 0.0), *values])


def content(torso: TorsoModel, state: TorsoState) -> bytes:
    """The file, at rest: FEBio's springs and tissue are at rest in the pose that is written.

    Raises
    ------
    TorsoError : the extra [febio] is not installed, or a state that is not rest.
    """
    require_rest("FEB", torso, state)
    try:
        import pyfebio as fe
    except ImportError:
        raise TorsoError('export to FEBio needs pyfebio; install it with pip install "spinestiff[febio]"') from None
    model = fe.model.Model()
    tissue, names, rest = torso.tissue, torso.bone_names, torso.rest_pose
    _add_materials(fe, model, torso)
    nodes = fe.mesh.Nodes(name="tissue")
    nodes.all_nodes = [fe.mesh.Node(text=_comma(p), id=i + 1) for i, p in enumerate(tissue.rest_positions)]
    model.mesh_.add_node_domain(nodes)
    element, kind = (fe.mesh.Tet10Element, "tet10") if tissue.elements.shape[1] == 10 else (fe.mesh.Tet4Element, "tet4")
    number = 0
    for m, (_, chosen) in enumerate(_materials(torso)):
        part = fe.mesh.Elements(name=f"tissue_{m + 1}", type=kind)
        part.all_elements = [
            element(text=",".join(map(str, nodes_ + 1)), id=number + i + 1)
            for i, nodes_ in enumerate(tissue.elements[chosen])
        ]
        number += len(chosen)
        model.mesh_.add_element_domain(part)
        model.meshdomains_.add_solid_domain(fe.meshdomains.SolidDomain(name=part.name, mat=part.name))
    before = len(tissue.rest_positions)
    for i, surface in enumerate(torso.bone_surfaces):
        name = names[i]
        bone = fe.mesh.Nodes(name=name)
        places = torso.surface_positions(rest, i)
        bone.all_nodes = [fe.mesh.Node(text=_comma(p), id=before + k + 1) for k, p in enumerate(places)]
        model.mesh_.add_node_domain(bone)
        shell = fe.mesh.Elements(name=f"{name}_surface", type="tri3")
        shell.all_elements = [
            fe.mesh.Tri3Element(text=",".join(map(str, face + before + 1)), id=number + k + 1)
            for k, face in enumerate(np.array(surface.faces))
        ]
        before, number = before + len(places), number + len(surface.faces)
        model.mesh_.add_element_domain(shell)
        domain = fe.meshdomains.ShellDomain(name=shell.name, mat=name, shell_thickness=_SHELL_MM)
        model.meshdomains_.add_shell_domain(domain)
    for i, name in enumerate(names):
        tied = np.flatnonzero(tissue.bone_of_node == i)
        if len(tied):
            text = ",".join(map(str, tied + 1))
            model.mesh_.add_node_set(
                fe.mesh.NodeSet(name=f"{name}_tied", text=text if len(tied) > 1 else f"{text},{text}")
            )
            model.boundary_.add_bc(fe.boundary.BCRigid(name=f"{name}_tied", node_set=f"{name}_tied", rb=name))
    _add_springs(fe, model, torso)
    written: Any = model.to_xml(pretty_print=True, encoding="ISO-8859-1", xml_declaration=True, skip_empty=True)
    return bytes(written)


def _materials(torso: TorsoModel) -> list[tuple[Floats, np.ndarray]]:
    # Each pair of Lame's parameters and its elements.
    pairs = np.stack([torso.tissue.lame_mu, torso.tissue.lame_lambda], -1)
    unique, inverse = np.unique(pairs, axis=0, return_inverse=True)
    return [(pair, np.flatnonzero(inverse.ravel() == m)) for m, pair in enumerate(unique)]


def _add_materials(fe: Any, model: Any, torso: TorsoModel) -> None:
    for m, (pair, _) in enumerate(_materials(torso)):
        mu, lambda_ = (float(v) for v in pair)
        young, poisson = mu * (3.0 * lambda_ + 2.0 * mu) / (lambda_ + mu), lambda_ / (2.0 * (lambda_ + mu))
        value = fe.material.MaterialParameter
        model.material_.add_material(
            fe.material.NeoHookean(name=f"tissue_{m + 1}", E=value(text=young), v=value(text=poisson))
        )
    for name, position in zip(torso.bone_names, torso.rest_pose.bone_positions):
        model.material_.add_material(fe.material.RigidBody(name=name, center_of_mass=_comma(position)))


def _add_springs(fe: Any, model: Any, torso: TorsoModel) -> None:
    table, rest = torso.joints, torso.rest_pose
    for j in range(len(table)):
        parent = int(table.parent[j])
        centre = rest.bone_positions[parent] + rest.bone_rotations[parent] @ table.parent_position[j]
        axes = rest.bone_rotations[parent] @ table.parent_axes[j]
        for k, (middle, direction, value) in enumerate(zip(*springs_of_joint(table.stiffness[j]))):
            if value <= 0.0:
                continue
            ends = [centre + axes @ (middle + sign * HALF_MM * direction) for sign in (-1.0, 1.0)]
            model.rigid_.add_rigid_connector(
                fe.rigid.RigidSpring(
                    name=f"{table.names[j]}_{k + 1}", body_a=torso.bone_names[parent],
                    body_b=torso.bone_names[int(table.child[j])], k=float(value), insertion_a=_comma(ends[0]),
                    insertion_b=_comma(ends[1]), free_length=2.0 * HALF_MM,
                )
            )  # fmt: skip


def _comma(values: Floats) -> str:
    return ",".join(f"{float(v):.9g}" for v in values)
