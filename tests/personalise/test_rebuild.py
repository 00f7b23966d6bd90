"""A subject in whose shape the carried mesh inverts: a new one is built there, or without a mesher one line says so."""

from __future__ import annotations

import re
import sys
from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.meshing import SPACINGS_MM
from spinestiff.anatomy.names import BONES
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import TorsoError
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import no_load, rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.personalise.measured_skin import TrunkSize, skin_at_sizes, trunk_sizes, with_trunk_sizes
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.personalise.quality import mesh_quality
from spinestiff.personalise.rebuild import can_rebuild, node_spacing, skin_of, with_new_tissue, without_tissue
from spinestiff.personalise.shape import personalise
from spinestiff.study.synthetic.spines import curved_spine, rest_vertebrae

VIEWS = {"frontal": frontal_view(), "lateral": lateral_view()}
# A curve of 40 degrees in a waist that is broad and flat: tissue between the lower ribs and the skin turns over.
BROAD, FLAT = 1.25, 0.87


@pytest.fixture(scope="module")
def subject(template):
    return place_vertebrae(template, *curved_spine(template, 40.0, "thoracic"))


@pytest.fixture(scope="module")
def waist(template):
    own = trunk_sizes(template, ("L2",))[0]["L2"]
    return {"L2": TrunkSize(BROAD * own.breadth_mm, FLAT * own.depth_mm)}


@pytest.fixture(scope="module")
def lines():
    return []


@pytest.fixture(scope="module")
def rebuilt(template, subject, waist, see, lines):
    pytest.importorskip("mmgpy", reason="needs MMG (extra [mesh])")
    pictures = {name: (see(subject, view), view) for name, view in VIEWS.items()}
    return personalise(template, pictures, lines.append, geometry="known", trunk=waist)


def test_the_carried_mesh_inverts(subject, waist):
    with pytest.raises(TorsoError, match=r"element \d+ has volume -"):
        with_trunk_sizes(subject, waist)


def test_bones_alone_keep_joints_boxes_and_landmarks(template):
    bare, state = without_tissue(template, template.rest_pose)
    assert bare.joints is template.joints
    assert bare.bone_names == BONES
    assert len(bare.tissue.rest_positions) == 0
    again = bare.rebased(state)
    assert again.joints.parent_position == pytest.approx(template.joints.parent_position, abs=1e-9)


def test_what_can_be_meshed_anew(template, monkeypatch):
    bare, _ = without_tissue(template, template.rest_pose)
    assert not can_rebuild(bare)
    monkeypatch.setitem(sys.modules, "mmgpy", None)
    assert not can_rebuild(template)


def test_a_skin_inside_the_bones_is_refused(template):
    points, faces = skin_of(template, template.rest_pose)
    bare, _ = without_tissue(template, template.rest_pose)
    with pytest.raises(TorsoError, match="sticks out of the skin by"):
        with_new_tissue(bare, (points * [0.8, 1.0, 0.8], faces), template, template.rest_pose, nodes=6000)


@pytest.mark.parametrize(("nodes", "height"), [(2300, 184.0), (200_000, 130.0)])
def test_a_number_of_nodes_that_can_not_be_meshed_is_told_with_those_that_can(template, nodes, height):
    with pytest.raises(TorsoError, match=rf"mesh of {nodes} nodes in a body of {height:g} cm has .* mm") as told:
        node_spacing(nodes, height)
    fewest, most = (int(number) for number in re.search(r"choose (\d+) to (\d+) nodes", str(told.value)).groups())
    low, high = SPACINGS_MM
    # Either end is the last one that can be meshed.
    assert node_spacing(fewest, height) <= high and node_spacing(most, height) >= low
    for beyond in (fewest - 1, most + 1):
        with pytest.raises(TorsoError):
            node_spacing(beyond, height)
    bare, _ = without_tissue(replace(template, height_cm=height), template.rest_pose)
    points, faces = skin_of(template, template.rest_pose)
    with pytest.raises(TorsoError, match="choose"):
        with_new_tissue(bare, (points, faces), template, template.rest_pose, nodes=nodes)


def test_the_skin_alone_comes_to_the_tape(subject, waist):
    points, faces = skin_of(subject, subject.rest_pose)
    moved = skin_at_sizes(subject, points, faces, waist)
    height = subject.rest_pose.bone_positions[subject.bone("L2"), 1]
    near = np.abs(moved[:, 1] - height) < 40.0
    assert np.ptp(moved[near, 0]) == pytest.approx(waist["L2"].breadth_mm, rel=0.1)
    assert np.array_equal(skin_at_sizes(subject, points, faces, {}), points)


@pytest.mark.slow
def test_the_subject_gets_a_new_mesh_and_is_told(rebuilt, template, subject, waist, lines):
    torso = rebuilt.torso
    assert rebuilt.mesh == "rebuilt"
    assert rebuilt.quality.good
    assert rebuilt.quality == mesh_quality(torso)
    assert any("a new one was built in the subject's skin" in line for line in rebuilt.warnings)
    assert any(line.endswith("building a new mesh") for line in lines)
    assert (torso.bone_names, torso.joints.names) == (BONES, template.joints.names)
    assert len(torso.joints) == 67
    nodes = len(torso.tissue.rest_positions) / len(template.tissue.rest_positions)
    assert 0.75 < nodes < 1.6  # a coarse mesh stays one: what is learnt of it holds
    assert set(torso.landmarks) == set(template.landmarks)
    assert np.abs(rest_vertebrae(torso)[0] - rest_vertebrae(subject)[0]).max() < 2.5
    found = trunk_sizes(torso, ("L2",))[0]["L2"]
    assert found.breadth_mm == pytest.approx(waist["L2"].breadth_mm, abs=1.0)
    assert found.depth_mm == pytest.approx(waist["L2"].depth_mm, abs=1.0)
    tied = np.bincount(torso.tissue.bone_of_node[torso.tissue.bone_of_node >= 0], minlength=49)
    assert tied.min() >= 3
    assert np.unique(torso.tissue.lame_mu).tolist() == pytest.approx([template.tissue.lame_mu[0]])


@pytest.mark.slow
def test_the_new_torso_is_free_of_stress_and_as_stiff_as_the_fine_mesh(rebuilt, waist):
    """Beside the fine template in the same shape, whose mesh bears that (flat, but not turned over)."""
    fine = template_torso(157.0, "fine")
    fine = place_vertebrae(fine, *curved_spine(fine, 40.0, "thoracic"))
    moved = []
    for torso in (rebuilt.torso, with_trunk_sizes(fine, waist)):
        problem = EquilibriumProblem(torso, three_point_supports(torso, "right"))
        if torso is rebuilt.torso:
            rest = problem.solve(no_load()).require().state
            assert np.abs(rest.bone_positions - torso.rest_pose.bone_positions).max() < 1e-8
        state = problem.solve(rib_push(torso, "right", 8, 20.0)).require().state
        moved.append((state.bone_positions - torso.rest_pose.bone_positions)[torso.vertebra_bones, 0])
    assert moved[1].max() > 0.2
    assert np.abs(moved[0] - moved[1]).max() < 0.1 * moved[1].max()


@pytest.mark.slow
def test_without_a_mesher_it_ends_in_one_line(template, subject, waist, see, monkeypatch):
    monkeypatch.setitem(sys.modules, "mmgpy", None)
    pictures = {name: (see(subject, view), view) for name, view in VIEWS.items()}
    with pytest.raises(TorsoError, match=r"leave no room .*; a finer tissue mesh may do; pip install") as caught:
        personalise(template, pictures, geometry="known", trunk=waist)
    assert "\n" not in str(caught.value)
