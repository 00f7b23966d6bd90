"""Discs that stiffen as they turn."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.names import INTERVERTEBRAL
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import EquilibriumError, SubjectError
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.joints import joint_pose
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.study.synthetic.stiffening import Stiffening, disc_bending, solved_with

LAW = Stiffening(0.4, 2.0)


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0)


@pytest.fixture(scope="module")
def wanted(torso):
    return stiffness_ratios({"lateral_bending": 0.3, "tissue": 0.2}, torso.joints.kinds)


def test_the_moment_is_the_one_that_is_written(torso):
    body, law = LAW.applied(torso)
    disc = next(i for i, kind in enumerate(torso.joints.kinds) if kind in INTERVERTEBRAL)
    rib = next(i for i, kind in enumerate(torso.joints.kinds) if kind == "rib_vertebra")
    theta = np.deg2rad(3.0)
    k = torso.joints.stiffness[disc, 5]
    strain = np.full((len(torso.joints), 6), theta)
    law.strains = lambda state: strain  # type: ignore[method-assign]
    linear = 0.5 * body.joints.stiffness * theta**2
    energy = linear + law.entries(torso.rest_pose, body.joints.stiffness)
    # The integral of k (0.4 + (theta / 2 degrees)^2) theta.
    assert energy[disc, 5] == pytest.approx(k * theta**2 * (0.4 / 2 + (3.0 / 2.0) ** 2 / 4))
    assert energy[disc, 0] == pytest.approx(0.5 * torso.joints.stiffness[disc, 0] * theta**2)
    assert energy[rib, 5] == pytest.approx(0.5 * torso.joints.stiffness[rib, 5] * theta**2)


def test_solved_with_ratios_store_the_energy_of_linear_discs_at_the_wanted_one(torso, wanted):
    body, law = LAW.applied(torso)
    problem = EquilibriumProblem(body, three_point_supports(torso, "right", "level"), laws=(law,))
    load = rib_push(torso, "right", 7.0, 25.0)
    found = solved_with(problem, law, torso, load, wanted)
    state = problem.solve(load, found).require().state
    pose = joint_pose(torso.joints, state)
    half = 0.5 * np.hstack([pose.translation, pose.rotation]) ** 2
    bending = wanted.groups[0].joints
    scaled = found.scale_joints(body.joints.stiffness)
    stored = (half * scaled + law.entries(state, scaled))[bending].sum()
    assert stored == pytest.approx(0.3 * (half * torso.joints.stiffness)[bending].sum(), rel=0.02)
    assert found.values[0] > 1.2 * wanted.values[0]  # small turns: the discs are softer than linear ones
    assert found.values[1] == wanted.values[1]


def test_what_no_ratio_makes_equal_is_told(torso, wanted):
    body, law = LAW.applied(torso)
    problem = EquilibriumProblem(body, three_point_supports(torso, "right", "level"), laws=(law,))
    load = rib_push(torso, "right", 7.0, 25.0)
    with pytest.raises(EquilibriumError, match="no ratios at which stiffening joints store as much"):
        solved_with(problem, law, torso, load, wanted, rounds=1)


@pytest.mark.parametrize(("low", "theta"), [(0.0, 3.0), (1.2, 3.0), (0.5, 0.1), (0.5, 90.0)])
def test_other_laws_are_refused(low, theta):
    with pytest.raises(SubjectError, match=r"wanted 0\.05 to 1 and 0\.5 to 45"):
        Stiffening(low, theta)


def test_discs_are_stiffer_by_moment_than_by_energy_and_linear_ones_are_neither(torso, wanted):
    body, law = LAW.applied(torso)
    problem = EquilibriumProblem(body, three_point_supports(torso, "right", "level"), laws=(law,))
    state = problem.solve(rib_push(torso, "right", 7.0, 40.0), wanted).require().state
    found = disc_bending(body, law, torso, state, wanted)
    turns = joint_pose(torso.joints, state).rotation[[kind in INTERVERTEBRAL for kind in torso.joints.kinds], 2]
    k = torso.joints.stiffness[[kind in INTERVERTEBRAL for kind in torso.joints.kinds], 5]
    # 0.3 k (0.4 + (theta / 2 degrees)^2) theta beside k theta.
    stiffer = (turns / np.deg2rad(2.0)) ** 2
    assert found["moment"] == pytest.approx(0.3 * (0.4 + (k * stiffer * turns**2).sum() / (k * turns**2).sum()))
    assert found["energy"] == pytest.approx(0.3 * (0.4 + 0.5 * (k * stiffer * turns**2).sum() / (k * turns**2).sum()))
    straight = Stiffening(1.0, 45.0)
    body, law = straight.applied(torso)
    assert disc_bending(body, law, torso, state, wanted) == pytest.approx({"energy": 0.3, "moment": 0.3}, rel=0.01)
