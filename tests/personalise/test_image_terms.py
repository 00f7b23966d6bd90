"""Image terms: zero where the picture is met, and derivatives that are the energy's."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import retract
from spinestiff.errors import TrackingError
from spinestiff.imaging.features import VertebraCorners, silhouette_choice, state_features
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.personalise.image_terms import corner_term

VIEWS = {"frontal": frontal_view(), "lateral": lateral_view()}


def seen(torso, view, state, rows=slice(None)):
    choice = silhouette_choice(torso, view, torso.rest_pose)
    return VertebraCorners(torso.vertebrae[rows], state_features(torso, view, state, choice).corners[rows]), choice


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


@pytest.fixture(scope="module")
def moved(torso):
    """The rest pose with every bone moved a little."""
    random = np.random.default_rng(0)
    step = np.zeros(torso.rest_pose.dofs)
    bones = step[: 6 * len(torso.bone_names)].reshape(-1, 6)
    bones[:, :3], bones[:, 3:] = (
        random.normal(0.0, 2.0, bones[:, :3].shape),
        random.normal(0.0, 0.03, bones[:, 3:].shape),
    )
    return retract(torso.rest_pose, step)


@pytest.mark.parametrize("name", VIEWS)
def test_energy_is_half_the_weighted_sum_of_squares(torso, moved, name):
    view = VIEWS[name]
    corners, choice = seen(torso, view, torso.rest_pose, slice(3, 14))
    term = corner_term(torso, view, corners, choice, 0.7)
    assert term.energy(torso.rest_pose) == pytest.approx(0.0, abs=1e-18)
    assert term.residuals(moved).shape == (11, 4, 2)
    assert term.energy(moved) == pytest.approx(0.35 * float(np.sum(term.residuals(moved) ** 2)), rel=1e-12)
    assert term.energy(moved) > 10.0


@pytest.mark.parametrize("name", VIEWS)
def test_gradient_agrees_with_differences(torso, moved, name):
    view = VIEWS[name]
    corners, choice = seen(torso, view, torso.rest_pose, slice(3, 14))
    term = corner_term(torso, view, corners, choice, 2.0)
    blocks = term.blocks(moved)
    assert blocks.bone.tolist() == torso.vertebra_bones[3:14].tolist()
    random = np.random.default_rng(1)
    for _ in range(3):
        change = random.standard_normal(blocks.gradient.shape) * [1, 1, 1, 0.02, 0.02, 0.02]
        step = np.zeros(moved.dofs)
        step[: 6 * len(torso.bone_names)].reshape(-1, 6)[blocks.bone] = change
        ahead, behind = (term.energy(retract(moved, h * step)) for h in (1e-4, -1e-4))
        assert float(np.sum(blocks.gradient * change)) == pytest.approx((ahead - behind) / 2e-4, rel=1e-6)


def test_hessian_is_gauss_and_newtons(torso, moved):
    """Where the residual vanishes it is the whole Hessian; it never has a negative direction."""
    view = VIEWS["frontal"]
    corners, choice = seen(torso, view, moved)
    term = corner_term(torso, view, corners, choice, 2.0)
    hessian = term.blocks(moved).hessian
    assert np.linalg.eigvalsh(hessian).min() > -1e-9 * np.abs(hessian).max()
    step = np.zeros(moved.dofs)
    change = np.tile([1.0, -0.5, 0.3, 0.01, 0.02, -0.03], (len(torso.vertebrae), 1))
    step[: 6 * len(torso.bone_names)].reshape(-1, 6)[torso.vertebra_bones] = change
    ahead, behind = (term.blocks(retract(moved, h * step)).gradient for h in (1e-4, -1e-4))
    wanted = (ahead - behind) / 2e-4
    assert np.einsum("vij,vj->vi", hessian, change) == pytest.approx(wanted, abs=1e-5 * np.abs(wanted).max())


def test_corners_of_another_anatomy_are_refused(torso):
    view = VIEWS["frontal"]
    corners, choice = seen(torso, view, torso.rest_pose)
    with pytest.raises(TrackingError, match=r"T1 in the picture is 4.* times its size"):
        corner_term(torso, view, VertebraCorners(corners.vertebrae, 4.0 * corners.corners), choice, 1.0)
