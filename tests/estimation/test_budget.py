"""The variance budget, and the estimate with other priors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.estimation.budget import (
    DISCREPANCY,
    DRAG,
    PERSONAL,
    STANCE,
    TRACKING,
    _changed,
    covariance_parts,
    linear_sds,
    prior_changes,
    repeated_sds,
    variance_budget,
)
from spinestiff.estimation.discrepancy_data import STANCE_MM
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.weighed import reduced


@pytest.fixture(scope="module")
def budget(asked, found):
    return variance_budget(asked, found)


def sd_of(found):
    model = reduced(found.point, found.slope, found.weights)
    return np.sqrt(np.diag(np.linalg.inv(model.ratios.T @ model.ratios)))


def test_every_unknown_and_every_part_of_the_noise_has_a_row(asked, budget) -> None:
    wanted = {*asked.unknowns.groups, *asked.noise.parts, DRAG, DISCREPANCY} - {STANCE}
    assert {row.name for row in budget.rows} == wanted
    assert len(budget.rows) == len(wanted)


def test_together_is_at_least_each_alone_and_without_is_at_most_together(budget) -> None:
    together, tracking = np.square(budget.together), np.square(budget.tracking)
    assert (tracking > 0.0).all()
    for row in budget.rows:
        alone, without = np.square(row.alone), np.square(row.without)
        assert (alone <= together * (1.0 + 1e-6)).all(), row.name
        assert (alone >= tracking * (1.0 - 1e-6)).all(), row.name
        assert (without <= together * (1.0 + 1e-6)).all(), row.name
    # No row is for show: each adds something that its absence spares.
    assert max(max(np.square(row.alone) / tracking) for row in budget.rows) > 1.5
    assert min(min(np.square(row.without) / together) for row in budget.rows) < 0.95


def test_together_is_the_fits_own_standard_deviation(found, budget) -> None:
    """But for the 0.02 mm that keep a frame annotated by hand from being the exact truth."""
    assert np.allclose(budget.together, sd_of(found), rtol=0.03)


def test_parts_add_up_to_the_fits_covariance(asked, found) -> None:
    parts = covariance_parts(asked, found)
    fixed = sum(parts[name] for name in (TRACKING, DRAG, DISCREPANCY, *asked.noise.parts))
    assert np.allclose(fixed, found.weights.root @ found.weights.root.T, atol=1e-9 * np.abs(fixed).max())
    moved = sum(parts[name] for name in asked.unknowns.groups)
    assert np.allclose(moved, found.slope.nuisances @ found.slope.nuisances.T, atol=1e-9)


def test_without_one_unknown_is_what_a_fit_without_it_would_say(column, noisy, found, budget) -> None:
    """Linear at another estimate, so to some percent."""
    exact = column.estimated(column.weighed(noisy, replace(Priors(), trunk=0.0)))
    row = next(row for row in budget.rows if row.name == "trunk size")
    gain = np.array(row.without) / np.array(budget.together)
    assert np.allclose(gain, sd_of(exact) / sd_of(found), rtol=0.05)


def test_other_priors_against_fits_with_them(column, noisy, asked, found, places) -> None:
    changes = prior_changes(asked, found, places)
    assert {change.name for change in changes} == {*asked.unknowns.groups, *asked.noise.parts, DRAG, DISCREPANCY}
    assert {change.factor for change in changes} == {0.5, 2.0}
    names = (("force scale", "force_scale"), ("push height", "push_height_mm"), ("annotation", "annotation_mm"))
    for name, prior in names:
        for factor in (0.5, 2.0):
            again = column.estimated(column.weighed(noisy, Priors().scaled(prior, factor)))
            change = next(change for change in changes if (change.name, change.factor) == (name, factor))
            apart = (np.log(change.ratios) - again.point.log_ratios) / sd_of(found)
            assert np.abs(apart).max() < 0.1, (name, factor)
            assert np.allclose(change.sd, sd_of(again), rtol=0.1), (name, factor)


def test_the_estimate_hardly_depends_on_a_prior_that_explains_nothing(asked, found, places) -> None:
    changes = prior_changes(asked, found, places)
    for change in changes:
        apart = (np.log(change.ratios) - found.point.log_ratios) / sd_of(found)
        assert np.abs(apart).max() < 1.0, change.name
    moved = {change.name: np.abs(np.log(change.ratios) - found.point.log_ratios).max() for change in changes}
    assert moved["source distance"] < 0.1 * sd_of(found).max()
    assert max(moved.values()) > 0.0


def test_visits_differ_by_what_is_not_the_persons_own(asked, found) -> None:
    """Its variance and that of the person's own add up to all of it."""
    own = repeated_sds(asked, found)
    total = sd_of(found)
    assert (own < 0.98 * total).all()
    assert (own > 0.1 * total).all()
    # As estimates of drawn errors scatter.
    parts = covariance_parts(asked, found)
    anew = sum(part for name, part in parts.items() if name not in PERSONAL)
    whole = sum(parts.values())
    values, vectors = np.linalg.eigh(anew)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    errors = root @ np.random.default_rng(0).normal(size=(len(root), 4000))
    x = found.slope.ratios
    inverse = np.linalg.inv(whole)
    estimates = np.linalg.solve(x.T @ inverse @ x, x.T @ inverse @ errors)
    assert np.allclose(estimates.std(axis=1), own, rtol=0.06)


def test_without_anything_of_the_persons_own_visits_differ_by_all(asked, found, monkeypatch) -> None:
    monkeypatch.setattr("spinestiff.estimation.budget.PERSONAL", ())
    assert np.allclose(repeated_sds(asked, found), sd_of(found), rtol=1e-3)


def test_annotating_again_brings_less_than_a_visit(asked, found) -> None:
    again, visit = repeated_sds(asked, found, annotation_alone=True), repeated_sds(asked, found)
    assert (again > 0.0).all()
    assert (again < visit).all()


def test_a_visit_finds_the_geometry_in_another_stance_too(asked, found, monkeypatch) -> None:
    """An annotation is off by the marks alone, a visit by the stance besides; both in proportion to corners' errors."""
    plain = [repeated_sds(asked, found, annotation_alone=alone) ** 2 for alone in (True, False)]
    monkeypatch.setattr(asked.moving, "of_geometry", lambda point, corner_mm: corner_mm**2 * np.eye(asked.noise.size))
    more = [repeated_sds(asked, found, annotation_alone=alone) ** 2 for alone in (True, False)]
    by_marks, by_both = (after - before for before, after in zip(plain, more, strict=True))
    assert (by_marks > 0.0).all()
    assert np.allclose(by_both / by_marks, 1.0 + (STANCE_MM / asked.priors.annotation_mm) ** 2)


def test_what_the_data_can_not_part_is_not_known() -> None:
    precise = linear_sds(np.diag([100.0, 4.0]))
    np.testing.assert_allclose(precise, [0.1, 0.5], rtol=1e-5)
    assert linear_sds(100.0 * np.ones((2, 2))).min() > 100.0


def test_where_another_prior_bends_the_likelihood_down_nothing_is_known_but_the_bounds(found) -> None:
    class Hill:
        """A likelihood that falls along one ratio from its least, as where it ends at a bound."""

        def psi(self, where):
            return 50.0 * (where[:, 0] - np.log(0.3)) ** 2 - 0.01 * (where[:, 1] - np.log(10.0)) ** 2

    limits = (np.log(0.01), np.log(10.0))
    change = _changed("trunk size", 2.0, Hill(), found, limits)
    assert change.sd == pytest.approx((0.1, limits[1] - limits[0]), rel=1e-3)
