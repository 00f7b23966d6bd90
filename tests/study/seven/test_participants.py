"""Who is in the study."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.study.paper import SUBJECTS
from spinestiff.study.seven.participants import (
    AGE,
    BENDING,
    COBB_DEG,
    FORCE_N,
    HEIGHT_CM,
    INITIAL_RMSE_MM,
    INITIAL_RMSE_SPREAD_MM,
    TISSUE,
    TISSUE_SCALE,
    others,
    seven,
)
from spinestiff.study.synthetic.stiffening import LOW, THETA_DEG


def test_the_seven_are_the_papers_with_the_stiffness_that_its_ratios_mean_here():
    for found, printed in zip(seven(), SUBJECTS, strict=True):
        same = ("age", "sex", "height_cm", "cobb_deg", "curve", "force_n", "bending")
        assert [getattr(found, name) for name in same] == [getattr(printed, name) for name in same]
        assert found.tissue == pytest.approx(1.3633 * printed.tissue, rel=1e-3)


def test_the_others_come_from_their_ranges_and_differ():
    found = others()
    assert len({one.name for one in found}) == len({one.seed for one in (*found, *seven())}) - 7 == 30
    for low, high, values in (
        (*AGE, [one.age for one in found]),
        (*HEIGHT_CM, [one.height_cm for one in found]),
        (*COBB_DEG, [abs(one.cobb_deg) for one in found]),
        (*FORCE_N, [abs(one.force_n) for one in found]),
        (*BENDING, [one.bending for one in found]),
        (TISSUE[0] * TISSUE_SCALE, TISSUE[1] * TISSUE_SCALE, [one.tissue for one in found]),
    ):
        assert low - 1e-4 <= min(values) < 0.5 * (low + high) < max(values) <= high + 1e-4
    assert {one.force_n > 0 for one in found} == {one.cobb_deg > 0 for one in found} == {True, False}
    assert others(3) == found[:3]


@pytest.mark.parametrize("one", [*seven(), *others(5)], ids=lambda one: one.name)
def test_a_recipe_holds_what_makes_it_no_inverse_crime(one):
    recipe = one.recipe()
    assert (recipe.mesh, recipe.misread, recipe.supports) == ("own", True, None)
    assert recipe.ratios == (one.bending, one.tissue)
    assert recipe.stiffening is not None
    assert LOW[0] <= recipe.stiffening.low <= LOW[1] and THETA_DEG[0] <= recipe.stiffening.theta_deg <= THETA_DEG[1]
    assert 0.25 <= recipe.secondary <= 0.5
    assert abs(one.initial_rmse_mm - INITIAL_RMSE_MM) <= INITIAL_RMSE_SPREAD_MM
    assert recipe.side == ("right" if one.force_n > 0 else "left")
    assert one.recipe(20.0).force_n == 20.0


def test_training_frames_lie_on_both_sides_of_the_validation_frame():
    main, rib, side = seven()[0].recipe().pushes
    by_role = {role: [s for s, r in zip(main.shares, main.roles) if r == role] for role in set(main.roles)}
    assert by_role["training"] == pytest.approx([2 / 3, 1.0]) and by_role["validation"] == pytest.approx([5 / 6])
    for other in (rib, side):
        assert other.roles == ("unused", "unused", "unused", "validation")
        np.testing.assert_allclose(other.shares, [0, 1 / 3, 2 / 3, 5 / 6])
    assert (rib.level, side.level, side.other_side, rib.other_side) == (8.1, main.level, True, False)
    assert seven()[1].recipe().pushes[1].level == 8.0  # above a lumbar curve's
