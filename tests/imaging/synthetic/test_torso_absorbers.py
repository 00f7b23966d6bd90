"""What of the template torso absorbs X-rays, and that the pictures look like a radiograph's."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.state import retract
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.synthetic.materials import tube_beam
from spinestiff.imaging.synthetic.path_length import path_length
from spinestiff.imaging.synthetic.rendering import Absorber, thicknesses
from spinestiff.imaging.synthetic.torso_absorbers import torso_absorbers

BEAM = tube_beam(75.0)
VIEW = frontal_view(shape=(256, 256), pixel=1.67)


def optical_depth(bodies: tuple[Absorber, ...]) -> np.ndarray:
    return np.asarray(-np.log(BEAM.transmitted(thicknesses(bodies, VIEW))))


@pytest.fixture(scope="module")
def torso() -> TorsoModel:
    return template_torso(160.0)


def test_every_body_is_closed_and_turned_outward(torso: TorsoModel) -> None:
    bodies = torso_absorbers(torso, torso.rest_pose)
    assert len(bodies) == 1 + 2 + 1 + 4 + len(torso.bone_names)  # skin, psoas, airways, lungs and their vessels
    for body in bodies:
        lengths = path_length(body.vertices, body.faces, frontal_view(shape=(256, 256), pixel=2.5))
        assert lengths.max() > 1.0
        # The diaphragm and the heart fold a lung's wall here and there.
        assert lengths.min() > (-0.1 if body.density < -0.5 else -1e-9)


def test_bone_is_brighter_than_tissue_and_tissue_than_lung(torso: TorsoModel) -> None:
    depth = optical_depth(torso_absorbers(torso, torso.rest_pose))
    position = torso.rest_pose.bone_positions

    def at(point: object) -> float:
        column, row = np.rint(VIEW.pixels(VIEW.project(point))).astype(int)
        return float(np.median(depth[row - 1 : row + 2, column - 1 : column + 2]))

    vertebra = position[torso.bone("L3")]
    assert at(vertebra) > at(vertebra + [60.0, 0.0, 0.0]) + 0.3
    chest = position[torso.bone("T6")]
    for side in (-1.0, 1.0):
        assert at(chest + [side * 60.0, 0.0, 0.0]) < at(vertebra + [side * 60.0, 0.0, 0.0]) - 1.0
    assert 3.0 < at(vertebra) < 9.0
    assert depth.min() > -1e-6


def test_bones_carry_their_texture_along(torso: TorsoModel) -> None:
    dx = np.zeros(torso.rest_pose.dofs)
    bone = torso.bone("T8")
    dx[6 * bone : 6 * bone + 6] = [4.0, -3.0, 0.0, 0.0, 0.0, 0.1]
    moved = torso_absorbers(torso, retract(torso.rest_pose, dx))[bone - len(torso.bone_names)]
    still = torso_absorbers(torso, torso.rest_pose)[bone - len(torso.bone_names)]
    assert moved.texture is not None
    assert still.texture is not None
    assert moved.texture.seed == still.texture.seed
    own = [(b.vertices - b.texture.position) @ b.texture.rotation for b in (moved, still) if b.texture is not None]
    np.testing.assert_allclose(own[0], own[1], atol=1e-9)


def test_the_seed_decides_the_patterns(torso: TorsoModel) -> None:
    a, b, c = (optical_depth(torso_absorbers(torso, torso.rest_pose, seed)) for seed in (0, 0, 90))
    np.testing.assert_array_equal(a, b)
    assert np.abs(a - c).max() > 0.01
