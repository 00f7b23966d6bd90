"""Vertebrae of another size: boxes, surfaces and tied tissue go along, joints and other bones stay."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.errors import TorsoError
from spinestiff.imaging.features import box_sizes
from spinestiff.imaging.pedicles import pedicle_centres
from spinestiff.personalise.quality import mesh_quality
from spinestiff.personalise.sizes import resized


@pytest.fixture(scope="module")
def factors():
    return np.exp(np.random.default_rng(2).normal(0.0, 0.08, (17, 3)))


@pytest.fixture(scope="module")
def other(template, factors):
    return resized(template, factors)


def test_boxes_and_surfaces_take_the_size(template, other, factors):
    assert box_sizes(other) == pytest.approx(box_sizes(template) * factors, rel=1e-12)
    for row, bone in enumerate(template.vertebra_bones):
        before, after = template.bone_surfaces[bone].vertices, other.bone_surfaces[bone].vertices
        half = 0.5 * box_sizes(template)[row]
        body = (np.abs(before) <= half).all(1)
        assert 0.2 < body.mean() < 0.9
        assert after[body] == pytest.approx(before[body] * factors[row], rel=1e-12)
        # Arch and processes keep their size: they move as far as the body's wall, no farther.
        assert (np.abs(after - before) <= np.abs(factors[row] - 1.0) * half + 1e-9).all()
    pelvis = template.bone("pelvis")
    assert other.bone_surfaces[pelvis].vertices is template.bone_surfaces[pelvis].vertices


def test_tied_tissue_goes_along_and_the_rest_stays_smooth(template, other, factors):
    before, after = template.tied_nodes, other.tied_nodes
    row = {bone: i for i, bone in enumerate(template.vertebra_bones.tolist())}
    of_vertebra = np.array([row.get(bone, -1) for bone in before.bone.tolist()])
    half = 0.5 * box_sizes(template)[of_vertebra]
    body = (of_vertebra >= 0) & (np.abs(before.offset) <= half).all(1)
    corner = np.isin(np.flatnonzero(template.tissue.bone_of_node >= 0), template.tissue.elements[:, :4])
    wanted = before.offset * factors[of_vertebra]
    assert (corner & body).sum() >= 17
    assert after.offset[corner & body] == pytest.approx(wanted[corner & body], abs=1e-9)
    others = corner & (of_vertebra < 0)
    assert after.offset[others] == pytest.approx(before.offset[others], abs=1e-9)
    moved = other.tissue.rest_positions - template.tissue.rest_positions
    free, tied = template.tissue.free_nodes, np.flatnonzero(template.tissue.bone_of_node >= 0)
    # Harmonic: nothing moves farther than what moves it, and what is next to it moves along.
    assert 0.2 < np.abs(moved[free]).max() <= np.abs(moved[tied]).max()
    assert other.rest_pose.tissue_positions == pytest.approx(other.tissue.rest_positions[free], abs=0.0)
    # Straight elements stay straight, also between vertebrae of unlike factors.
    assert mesh_quality(other).smallest_j == pytest.approx(mesh_quality(template).smallest_j, abs=1e-6)
    assert mesh_quality(other).good


def test_bones_and_joints_stay(template, other):
    assert np.array_equal(other.rest_pose.bone_positions, template.rest_pose.bone_positions)
    assert other.joints is template.joints


def test_sizes_that_no_vertebra_has_are_refused(template):
    factors = np.ones((17, 3))
    factors[4] = 1.0, 2.6, 1.0
    with pytest.raises(TorsoError, match=r"T5 would be \[1.0, 2.6, 1.0\] times its size"):
        resized(template, factors)


def test_pedicles_lie_where_the_surfaces_have_them(template):
    """Behind the body, left and right alike, within the bone's own extent."""
    centres, sizes = pedicle_centres(template), box_sizes(template)
    assert np.array_equal(centres[:, 0] * [-1.0, 1.0, 1.0], centres[:, 1])
    assert (centres[:, 0, 2] < -0.5 * sizes[:, 2]).all()
    for row, bone in enumerate(template.vertebra_bones):
        vertices = template.bone_surfaces[bone].vertices
        near = vertices[np.linalg.norm(vertices - centres[row, 0], axis=1) < 8.0]
        assert len(near) >= 3
