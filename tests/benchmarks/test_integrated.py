"""benchmarks/integrated.py: around which likelihood drawn corners lie."""

from __future__ import annotations

import json

import numpy as np
import pytest

from programs import benchmark

benchmark("coverage_subjects")
integrated = benchmark("integrated")


class Scaled:
    """Five residuals of an exponential of one log ratio, each with a relative error of its own as a nuisance."""

    RELATIVE, PRECISE = 0.4, 40.0

    def residuals(self, where):
        size = self.PRECISE * np.exp(-np.atleast_2d(where)[:, 0])
        return np.outer(size, np.ones(5)), size[:, None, None] * self.RELATIVE * np.eye(5)[None]


def test_the_most_probable_nuisances_draw_towards_what_they_do_most_to():
    """Nuisances that are nearly told by the residuals: integrated out they are what they are, relative errors."""
    most, out = integrated.drawn_z(Scaled(), np.zeros(1), np.array([0.2]), 2000, np.random.default_rng(1))
    assert most.mean() < -0.5
    assert abs(out.mean()) < 0.5 * abs(most.mean())
    assert (np.abs(out) < 1.96).mean() > (np.abs(most) < 1.96).mean()


def test_errors_smaller_than_they_are_taken_to_be_draw_to_what_makes_them_small():
    """What is soft moves far under each nuisance: seen without any, it is taken for something stiffer."""
    sizes = np.repeat([1.0, 0.5, 0.0], [2000, 2000, 1])
    _, out = integrated.drawn_z(Scaled(), np.zeros(1), np.array([0.2]), len(sizes), np.random.default_rng(1), sizes)
    whole, half, none = (out[0, sizes == size].mean() for size in (1.0, 0.5, 0.0))
    assert none > half > whole + 0.1
    assert np.std(out[0, sizes == 0.5]) < 0.6 * np.std(out[0, sizes == 1.0])


def test_a_persons_own_truth_is_as_far_off_as_the_two_say():
    """Two parabolas of standard deviation 0.2, half a log apart."""

    class Two:
        def phi(self, where):
            return 0.5 * np.sum((where / 0.2) ** 2, axis=1)

        def psi(self, where):
            return 0.5 * np.sum(((where - [0.5, 0.0]) / 0.2) ** 2, axis=1)

    z = integrated.own_z(Two(), np.array([0.1, 0.0]), np.array([-0.2, 0.3]), np.array([0.2, 0.2]))
    assert z == pytest.approx(np.array([[1.0, -1.5], [3.5, -1.5]]), abs=0.02)


def row(seed, means):
    return {
        "seed": seed,
        "draws": 10,
        "code": "a",
        "smaller errors": {"0.75": [means[1], 0.0], "0.5": [2.0 * means[1], 0.0], "0": [seed, 0.0]},
        **{
            kind: {"mean_z": [m, 0.0], "sd_of_z": [1.0, 1.0], "inside95": [0.9, 0.95], "own_z": [seed + m, 1.0]}
            for kind, m in zip(integrated.KINDS, means)
        },
    }


def test_what_is_summed_up():
    found = integrated.summed_up([row(1, (-0.3, 0.1)), row(2, (-0.1, 0.0)), {"seed": 3, "not made": "why"}])
    assert (found["people"], found["draws"]) == (2, 20)
    assert found["most probable"]["mean_z"]["lateral_bending"] == pytest.approx([-0.2, 0.1])
    assert found["own_z_moved"]["lateral_bending"] == pytest.approx([0.25, 0.15])
    assert found["integrated out"]["inside95"]["lateral_bending"][0] == pytest.approx(0.9)
    assert found["smaller errors, mean z"]["0.5"]["lateral_bending"] == pytest.approx([0.1, 0.1])
    assert found["smaller errors, mean z"]["0"]["lateral_bending"] == pytest.approx([1.5, 0.5])
    assert integrated.summed_up([row(1, (-0.3, 0.1))])["own_z_moved"]["tissue"] == [0.0, None]
    with pytest.raises(SystemExit, match="no row has figures"):
        integrated.summed_up([{"seed": 3, "not made": "why"}])


def test_the_page_has_the_stored_figures_of_smaller_errors():
    page = (integrated.ROOT / "docs" / "estimation.md").read_text(encoding="utf-8")
    stored = json.loads(integrated.RESULTS.read_text(encoding="utf-8"))
    columns = [stored["integrated out"]["mean_z"], *stored["smaller errors, mean z"].values()]
    for name, title in (("lateral_bending", "bending"), ("tissue", "tissue")):
        cells = " | ".join(f"{mean:.2f} ± {error:.2f}" for mean, error in (one[name] for one in columns))
        assert f"| mean z of {title} | {cells} |" in page


def test_the_page_has_what_is_left_of_an_error_where_all_is_given():
    page = (integrated.ROOT / "docs" / "coverage.md").read_text(encoding="utf-8")
    stored = json.loads((integrated.RESULTS.parent / "shared_error_few.json").read_text(encoding="utf-8"))
    nothing, torso, _, everything = (one["lateral_bending"]["mean_over_sd"] for one in stored["given"].values())
    assert f"off by {nothing:.2f} standard deviations of the estimate on average, by {torso:.2f} on the true" in page
    assert f"still by {everything:.2f} where true torso, corners, forces and ribs are given" in page
