"""Breadths and depths by tape: the skin comes to them, the bones stay."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.errors import TorsoError
from spinestiff.personalise.measured_skin import (
    TrunkSize,
    skin_at_sizes,
    trunk_misses,
    trunk_sizes,
    with_trunk_sizes,
)
from spinestiff.personalise.quality import mesh_quality

LEVELS = ("T9", "L3")


@pytest.fixture(scope="module")
def wanted(template):
    own, _ = trunk_sizes(template, LEVELS)
    factors = {"T9": (1.06, 1.08), "L3": (0.95, 1.10)}
    return {v: TrunkSize(own[v].breadth_mm * f[0], own[v].depth_mm * f[1]) for v, f in factors.items()}


@pytest.fixture(scope="module")
def fitted(template, wanted):
    return with_trunk_sizes(template, wanted)


def test_the_templates_extents_are_the_skins(template):
    """Against the published breadth and depth of the waist that the skin is made from (240 by 174 mm at 157 cm)."""
    own, middles = trunk_sizes(template, ("L3",))
    assert own["L3"].breadth_mm == pytest.approx(240.0, rel=0.08)
    assert own["L3"].depth_mm == pytest.approx(174.0, rel=0.12)
    assert middles[0, 0] == pytest.approx(0.0, abs=2.0)


def test_the_skin_comes_to_the_tape(wanted, fitted):
    found, _ = trunk_sizes(fitted, LEVELS)
    for level in LEVELS:
        assert found[level].breadth_mm == pytest.approx(wanted[level].breadth_mm, abs=0.5)
        assert found[level].depth_mm == pytest.approx(wanted[level].depth_mm, abs=0.5)


@pytest.mark.parametrize("above", [0.0, 1.0])
def test_corners_of_the_skin_at_the_very_height_count(template, above):
    """A tube whose rings lie at a bone's height and around it: the middle one as a whole, or its outermost corners."""
    height = template.rest_pose.bone_positions[template.bone("T9"), 1]
    turn = 2.0 * np.pi * np.arange(24) / 24
    rings = np.stack([[120.0 * np.cos(turn), np.full(24, height + y), 90.0 * np.sin(turn)] for y in (-50, 0, 50)])
    rings[1, 1] += np.where(np.arange(24) % 12 == 0, 0.0, above)
    i, j = np.arange(24), (np.arange(24) + 1) % 24
    quarter = np.concatenate([np.stack([i, j, i + 24], 1), np.stack([j, j + 24, i + 24], 1)])
    points, faces = rings.transpose(0, 2, 1).reshape(-1, 3), np.concatenate([quarter, quarter + 24])
    own = TrunkSize(240.0, 180.0)
    assert skin_at_sizes(template, points, faces, {"T9": own}) == pytest.approx(points, abs=1e-9)


def test_bones_stay_and_the_mesh_is_good(template, fitted):
    assert fitted.joints is template.joints
    assert np.array_equal(fitted.rest_pose.bone_positions, template.rest_pose.bone_positions)
    corner = np.zeros(len(template.tissue.rest_positions), dtype=bool)
    corner[template.tissue.elements[:, :4]] = True
    tied = corner & (template.tissue.bone_of_node >= 0)
    assert np.array_equal(fitted.tissue.rest_positions[tied], template.tissue.rest_positions[tied])
    moved = np.linalg.norm(fitted.tissue.rest_positions - template.tissue.rest_positions, axis=1)
    assert 4.0 < moved.max() < 20.0
    # Far from the measured levels nothing moves.
    far = template.tissue.rest_positions[:, 1] > template.rest_pose.bone_positions[template.bone("T1"), 1]
    assert moved[far].max(initial=0.0) < 2.0
    assert mesh_quality(fitted).good


def _changed(template, factors):
    own, _ = trunk_sizes(template, tuple(factors))
    return {v: TrunkSize(own[v].breadth_mm * b, own[v].depth_mm * d) for v, (b, d) in factors.items()}


def test_levels_that_share_triangles_come_to_the_tape_too(template):
    """Each round of stretching at one spoils the other by some of it."""
    wanted = _changed(template, {"T12": (1.006, 0.993), "L1": (1.033, 1.005)})
    fitted = with_trunk_sizes(template, wanted)
    assert max(miss for _, miss in trunk_misses(fitted, wanted).values()) < 0.5
    assert mesh_quality(fitted).good


def test_what_a_coarse_mesh_does_not_bear_is_said(template):
    """Neighbours that differ by 4 % within one edge of the skin: to reach them, elements would have to turn over."""
    wanted = _changed(template, {"L3": (0.961, 0.936), "L4": (0.988, 1.021)})
    fitted = with_trunk_sizes(template, wanted)
    assert mesh_quality(fitted).good
    found, _ = trunk_sizes(fitted, ("L3",))
    misses = trunk_misses(fitted, wanted)
    assert misses["L3"][0] == found["L3"]
    assert misses["L3"][1] == pytest.approx(found["L3"].breadth_mm - wanted["L3"].breadth_mm)
    assert misses["L3"][1] > 2.0


def test_nothing_measured_changes_nothing(template):
    assert with_trunk_sizes(template, {}) is template
    assert trunk_misses(template, {}) == {}


def test_a_skin_inside_the_ribs_is_refused(template):
    own, _ = trunk_sizes(template, ("T9",))
    narrow = TrunkSize(0.85 * own["T9"].breadth_mm, own["T9"].depth_mm)
    with pytest.raises(TorsoError, match=r"the ribs, which they don't move, leave no room .* leave them out"):
        with_trunk_sizes(template, {"T9": narrow})


def test_measures_of_someone_else_are_refused(template):
    with pytest.raises(TorsoError, match=r"breadth at T9 is 500 mm, .* times the skin's"):
        with_trunk_sizes(template, {"T9": TrunkSize(500.0, 190.0)})
    with pytest.raises(TorsoError, match="wanted both above 0"):
        TrunkSize(0.0, 100.0)
    with pytest.raises(TorsoError, match="no bone 'C7'"):
        with_trunk_sizes(template, {"C7": TrunkSize(200.0, 150.0)})
