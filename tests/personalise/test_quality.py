"""The quality of a tissue mesh: known angles, and a distortion that is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.errors import TorsoError
from spinestiff.personalise.quality import mesh_quality, require_quality


def test_the_template_is_good(template):
    found = require_quality(template)
    assert 0.2 < found.smallest_j <= 1.0
    assert 2.0 < found.smallest_dihedral_deg < 60.0


def test_a_node_pushed_through_its_neighbours_is_found(template):
    """The middle of an element's edge moved nearly onto a corner: the Jacobian breaks down, the corners stay."""
    mesh = template.tissue
    element = next(i for i, nodes in enumerate(mesh.elements) if (mesh.bone_of_node[nodes[[0, 1, 4]]] < 0).all())
    nodes = np.array(mesh.rest_positions)
    a, _, middle = mesh.elements[element][[0, 1, 4]]
    nodes[middle] = nodes[a] + 0.05 * (nodes[middle] - nodes[a])
    pose = replace(template.rest_pose, tissue_positions=nodes[mesh.free_nodes])
    bad = replace(template, tissue=replace(mesh, rest_positions=nodes), rest_pose=pose)
    assert mesh_quality(bad).smallest_j < 0.2
    with pytest.raises(TorsoError, match="too distorted after the fit"):
        require_quality(bad)
