"""Kriging through values and slopes, and phi read from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.estimation.emulator import SLOPE_NOISES, Emulator, Kriging, Place
from spinestiff.estimation.profiles import likely_ratios
from spinestiff.estimation.weighed import phi, reduced
from spinestiff.mechanics.equilibrium import EquilibriumProblem

PLACES = np.array([[0.0, 0.0], [0.6, 0.1], [-0.5, 0.4], [0.2, -0.7], [-0.3, -0.4], [0.7, 0.7], [-0.6, -0.6]])


def cubic(where):
    """Three cubic functions of two variables, and their slopes (K, 3, 2)."""
    x, y = where.T
    values = np.stack([1.0 + 2.0 * x - y, x**2 - x * y + 0.5 * y**2, x**3 - 2.0 * x * y**2 + y], 1)
    slopes = np.stack(
        [
            np.stack([2.0 + 0.0 * x, -1.0 + 0.0 * x], 1),
            np.stack([2.0 * x - y, y - x], 1),
            np.stack([3.0 * x**2 - 2.0 * y**2, 1.0 - 4.0 * x * y], 1),
        ],
        1,
    )
    return values, slopes


def test_values_and_slopes_are_met_where_they_are_known() -> None:
    values, slopes = cubic(PLACES)
    found = Kriging(PLACES, values, slopes)
    assert np.allclose(found.at(PLACES), values, atol=0.05)
    for i, step in enumerate(1e-4 * np.eye(2)):
        quotient = (found.at(PLACES + step) - found.at(PLACES - step)) / 2e-4
        assert np.allclose(quotient, slopes[..., i], atol=0.05)


def test_a_cubic_is_met_between_places_and_slopes_help() -> None:
    values, slopes = cubic(PLACES)
    between = np.array([[0.3, 0.05], [-0.2, 0.2], [0.1, -0.3], [0.4, 0.4], [-0.4, -0.5]])
    wanted = cubic(between)[0]
    with_slopes, without = (Kriging(PLACES, values, given).at(between) - wanted for given in (slopes, None))
    # Of values that vary by about 2.
    assert np.abs(with_slopes).max() < 0.02
    assert np.abs(without).max() > 2.0 * np.abs(with_slopes).max()


def test_one_place_is_first_order_around_it() -> None:
    values, slopes = cubic(PLACES[:1])
    found = Kriging(PLACES[:1], values, slopes).at(np.array([[0.2, -0.1]]))
    assert np.allclose(found, values + slopes[0] @ [0.2, -0.1])


def test_a_difference_keeps_to_where_it_was_seen() -> None:
    values, slopes = cubic(PLACES)
    level = Kriging(PLACES, values, slopes, length=0.7, rising=False)
    assert np.allclose(level.at(PLACES), values, atol=0.05)
    far = PLACES[:1] + [[-3.0, 3.5], [4.0, 0.0]]
    assert np.allclose(level.at(far), values[0], atol=1e-3)
    assert not np.allclose(Kriging(PLACES, values, slopes).at(far), values[0], atol=0.5)


def test_the_likeliest_length_is_that_over_which_a_function_changes() -> None:
    x = np.linspace(-1.0, 1.0, 7)[:, None]
    lengths = (0.3, 0.7, 1.5, 3.0)
    chosen = []
    for wave in (0.3, 3.0):
        values, slopes = np.sin(x / wave), (np.cos(x / wave) / wave)[:, None]
        found = [float(Kriging(x, values, slopes, one, rising=False).log_likelihood[0]) for one in lengths]
        chosen.append(lengths[int(np.argmax(found))])
    assert chosen[0] < 1.0 < chosen[1]


@pytest.fixture(scope="module")
def emulator(likely) -> Emulator:
    return likely.emulator


def test_phi_is_the_models_where_the_model_was_solved(places, found, emulator) -> None:
    for place in places:
        if not (np.abs(emulator.log_ratios - place.point.log_ratios).max(axis=1) < 1e-9).any():
            continue
        model = reduced(place.point, place.slope, found.weights)
        solved = 0.5 * float(model.values @ model.values)
        assert emulator.phi(place.point.log_ratios)[0] == pytest.approx(solved, abs=0.08)
        assert np.allclose(emulator.nuisances(place.point.log_ratios)[0], model.nuisances, atol=0.05)
    assert emulator.phi(found.point.log_ratios)[0] == pytest.approx(phi(found.point, found.weights), abs=2e-2)


def test_phi_and_nuisances_between_places_against_the_model(asked, found, emulator) -> None:
    """At a place half an sd away from the estimate, where nothing was solved, with nuisances searched for."""
    where = found.point.log_ratios + [0.12, -0.1]
    assert np.abs(emulator.log_ratios - where).max(axis=1).min() > 0.05
    nuisances, covariance = emulator.nuisances(where)
    point, slope, most = found.point, found.slope, nuisances
    for _ in range(4):
        point = asked.solve(where, most, point, slope)
        slope = asked.slope(point)
        most = reduced(point, slope, found.weights).nuisances
    assert emulator.phi(where)[0] == pytest.approx(phi(point, found.weights), abs=0.01)
    assert np.allclose(nuisances, most, atol=0.05)
    columns = found.weights.whiten(slope.nuisances)
    exact = np.linalg.inv(np.eye(len(most)) + columns.T @ columns)
    assert np.allclose(covariance, exact, atol=0.05)


def test_wider_priors_lower_phi_as_the_model_with_them_says(found) -> None:
    """One place: twice the prior sd of all nuisances is twice the columns."""
    place = Place(found.point, found.slope)
    wide = Emulator([place], found.weights, np.full(len(found.point.nuisances), 2.0))
    whitened = found.weights.whiten(np.column_stack([found.slope.nuisances, found.point.values]))
    columns, free = 2.0 * whitened[:, :-1], whitened[:, -1] - whitened[:, :-1] @ found.point.nuisances
    best = np.linalg.solve(np.eye(columns.shape[1]) + columns.T @ columns, -columns.T @ free)
    wanted = 0.5 * float(np.sum((free + columns @ best) ** 2) + best @ best)
    assert wide.phi(found.point.log_ratios)[0] == pytest.approx(wanted, rel=1e-9)
    assert wanted < phi(found.point, found.weights)
    # Still in units of the narrow ones.
    assert np.allclose(wide.nuisances(found.point.log_ratios)[0], 2.0 * best)


def test_places_that_tell_nothing_are_left_out(asked, found, places) -> None:
    estimate = Place(found.point, found.slope)
    near = asked.solve(found.point.log_ratios + 0.01, found.point.nuisances, found.point, found.slope)
    strange = asked.solve(found.point.log_ratios + 0.2, found.point.nuisances + 3.0, found.point, found.slope)
    high = asked.solve(found.point.log_ratios + [2.0, 2.0], found.point.nuisances, found.point, found.slope)
    others = [Place(point, asked.slope(point)) for point in (near, strange, high)]
    assert len(Emulator([estimate, *others], found.weights).log_ratios) == 1
    assert len(Emulator(places, found.weights).log_ratios) > 3


def test_places_of_a_rougher_model_tell_the_shape(column, noisy, found, places) -> None:
    """From the estimate alone, all else known on a spine whose joints are a twentieth stiffer.

    phi elsewhere is known four times as well as from the estimate's own slopes."""
    joints = replace(column.torso.joints, stiffness=1.05 * column.torso.joints.stiffness)
    torso = replace(column.torso, joints=joints)
    other = replace(column, problem=EquilibriumProblem(torso, column.problem.supports))
    asked = other.weighed(noisy)
    there = other.searched(asked)
    rough = likely_ratios(asked, there, [Place(*place) for place in there.visited])[1]
    estimate = [Place(found.point, found.slope)]
    own, both = Emulator(estimate, found.weights), Emulator(estimate, found.weights, rough=rough)
    assert both.phi(found.point.log_ratios)[0] == pytest.approx(phi(found.point, found.weights), abs=1e-2)
    where = np.array([place.point.log_ratios for place in places[1:]])
    models = [reduced(place.point, place.slope, found.weights) for place in places[1:]]
    wanted = np.array([0.5 * float(model.values @ model.values) for model in models])
    likely = wanted - wanted.min() < 5.0
    off, without = (np.abs(emulator.phi(where) - wanted)[likely] for emulator in (both, own))
    assert off.max() < 0.25 * without.max()


def test_slopes_of_creases_lead_nowhere(found, places, monkeypatch) -> None:
    """Three places close together, whose slopes in the ratios jump by far more than what lies between them tells.

    A difference that met them would be as large as the jumps a factor of three away; its own noise is the likelier.
    """
    rough = [Place(found.point, found.slope), *places[1:]]
    random, close = np.random.default_rng(3), []
    for shift in ([0.0, 0.0], [0.04, -0.03], [-0.03, 0.05]):
        place = rough[0]
        log_ratios = place.point.log_ratios + shift
        evaluation = replace(place.point.evaluation, log_ratios=log_ratios)
        point = replace(place.point, evaluation=evaluation)
        jump = 1.0 + 3.0 * random.normal(size=place.slope.ratios.shape)
        close.append(Place(point, replace(place.slope, ratios=place.slope.ratios * jump)))
    known, off = Emulator(rough, found.weights), []
    for noises in ((0.0,), SLOPE_NOISES):
        monkeypatch.setattr("spinestiff.estimation.emulator.SLOPE_NOISES", noises)
        emulator = Emulator(close, found.weights, telling=False, rough=rough)
        assert len(emulator.log_ratios) == 3
        far = found.point.log_ratios + np.array([[0.8, -0.6], [-0.9, 0.7], [1.1, 0.3]])
        apart = [emulator.nuisances(where)[0] - known.nuisances(where)[0] for where in far]
        off.append((np.abs(apart).max(), np.abs(emulator.phi(far) - known.phi(far)).max()))
    # Nuisances in their prior's sds, and phi.
    assert off[1][0] < 2.0
    assert off[1][1] < 5.0
    assert off[0][0] > 20.0
    assert off[0][1] > 30.0


def test_noise_of_slopes_is_told_from_a_function_that_changes_quickly() -> None:
    x = np.linspace(-0.2, 0.2, 5)[:, None]
    noise = np.array([3.0, -2.5, 1.0, -3.5, 2.0])[:, None, None]
    smooth, slopes = np.sin(2.0 * x), (2.0 * np.cos(2.0 * x))[:, None]
    for extra, wanted in ((0.0 * noise, 0.0), (noise, 1.0)):
        tried = {v: Kriging(x, smooth, slopes + extra, 0.7, False, v) for v in (0.0, 1.0)}
        assert max(tried, key=lambda v: float(tried[v].log_likelihood[0])) == wanted
    far = np.array([[0.7]])
    off = [abs(float(tried[v].at(far)[0, 0]) - np.sin(1.4)) for v in (0.0, 1.0)]
    assert off[1] < 0.5 * off[0]
