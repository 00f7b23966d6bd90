"""The truth of a synthetic subject: what is one, and how far an estimate lies from it."""

from __future__ import annotations

import numpy as np
import pytest

from results import register
from spinestiff.errors import SubjectError
from spinestiff.files import read_json, write_json
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.study import steps
from spinestiff.study.truth import compare_with_truth, known_comparison, read_truth, true_values
from spinestiff.study.visit import load_pushes, open_visit
from spinestiff.subject.assessment_outcome import Comparison
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.run_record import read_outcome


def with_truth(tmp_path, **ratios):
    path = tmp_path / "other.truth.json"
    write_json(path, {"ratios": ratios})
    return path


@pytest.fixture(scope="module")
def made(finished):
    """The finished subject's estimate and trials."""
    visit = open_visit(finished.folder)
    return read_outcome(visit.subject, Estimate), load_pushes(visit, visit.manner)


def test_the_truth_is_measured_on_the_model(finished, made, tmp_path):
    """At the estimate itself the distance is 0; for truths near it the linear answer; far off it is outside."""
    fit = finished.fit
    at_estimate = compare_with_truth(*made, with_truth(tmp_path, **fit.ratios.as_dict()))
    # The search ends about a thousandth of a standard deviation from its minimum.
    assert at_estimate.distance2 < 0.003**2
    assert at_estimate.inside is True
    direction = np.linalg.cholesky(fit.covariance) @ np.array([0.6, 0.8])
    near = [dict(zip(fit.names, np.exp(np.log(fit.ratios.values) + s * direction).tolist())) for s in (0.1, -0.1)]
    # Of both sides: the estimate is settled to a hundredth of a standard deviation.
    both = [compare_with_truth(*made, with_truth(tmp_path, **beside)).distance2 for beside in near]
    assert np.mean(both) == pytest.approx(0.1**2, rel=0.1)
    stiff = compare_with_truth(*made, with_truth(tmp_path, lateral_bending=1.0, tissue=1.0))
    assert stiff.truth == {"lateral_bending": 1.0, "tissue": 1.0}
    assert stiff.distance2 > stiff.region_size == made[0].region_size
    assert stiff.inside is False


def test_the_distance_from_the_estimates_own_states_is_that_from_rest(finished, made, tmp_path, monkeypatch):
    states, starts = [one.state for one in finished.fit.equilibria], []

    def seen(self, load, ratios=None, start=None, *args, solve=EquilibriumProblem.solve_linearised, **kwargs):
        starts.append((load.size, start))
        return solve(self, load, ratios, start, *args, **kwargs)

    truth = with_truth(tmp_path, lateral_bending=0.3, tissue=0.03)
    from_rest = compare_with_truth(*made, truth)
    monkeypatch.setattr(EquilibriumProblem, "solve_linearised", seen)
    from_states = compare_with_truth(*made, truth, states)
    assert from_states.distance2 == pytest.approx(from_rest.distance2, rel=1e-4)
    by_force = np.argsort([frame.force_n for frame in made[1].training])
    first = sorted(starts[: len(states)], key=lambda one: one[0])
    assert all(start is states[i] for (_, start), i in zip(first, by_force, strict=True))


def test_assess_starts_the_comparison_at_the_estimates_states(subject, finished, monkeypatch):
    given = []

    def compared(estimate, pushes, truth, starts=None):
        given.append(starts)
        return Comparison(truth=read_truth(truth), region_size=None, distance2=None, inside=None)

    monkeypatch.setattr(steps, "compare_with_truth", compared)
    steps.assess_step(open_visit(subject, truth=finished.truth), lambda line: None)
    for start, one in zip(given[0], finished.fit.equilibria, strict=True):
        assert np.array_equal(start.bone_positions, one.state.bone_positions)


def test_without_a_region_there_is_no_distance(finished, made):
    estimate, pushes = made
    found = compare_with_truth(estimate.model_copy(update={"region_size": None}), pushes, finished.truth)
    assert (found.distance2, found.inside) == (None, None)
    assert found.truth == read_json(finished.truth)["ratios"]


def test_a_comparison_is_read_for_its_own_truth_alone(finished, subject, tmp_path):
    found = known_comparison(open_visit(finished.folder).subject, finished.truth)
    assert found.inside is (found.distance2 <= found.region_size)
    read = open_visit(subject).subject
    another = with_truth(tmp_path, lateral_bending=0.3, tissue=0.05)
    again = f"run spinestiff assess {subject} --truth {another}$"
    with pytest.raises(SubjectError, match=rf"compares with other true ratios than those of {another}; {again}"):
        known_comparison(read, another)
    (subject / "results" / Comparison.FILE).unlink()
    with pytest.raises(SubjectError, match=rf"comparison\.json: no such file; {again}"):
        known_comparison(read, another)
    write_json(subject / "results" / Comparison.FILE, [])
    register(read, "assess", Comparison.FILE)
    with pytest.raises(SubjectError, match=r"comparison\.json: found schema_version None"):
        known_comparison(read, another)


def test_the_truth_of_a_part_is_its_groups():
    truth = {"lateral_bending": 0.1, "tissue": 0.04}
    parts = ("lateral_bending@thoracic", "lateral_bending@lumbar", "tissue")
    assert true_values(parts, truth) == {parts[0]: 0.1, parts[1]: 0.1, "tissue": 0.04}
    beside = ("lateral_bending", "lateral_bending@lumbar", "axial_rotation@T8-T9")
    assert true_values(beside, truth) == {"lateral_bending": 0.1, "lateral_bending@lumbar": 1.0}


def test_the_truth_of_parts_is_none_of_a_part_beside_its_whole():
    """There a part's ratio is relative to the whole's, which such a truth does not tell."""
    truth = {"lateral_bending@thoracic": 0.1, "lateral_bending@lumbar": 0.2}
    assert true_values(tuple(truth), truth) == truth
    assert true_values(("lateral_bending", "lateral_bending@lumbar"), truth) == {}


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("lateral_bendin", "'lateral_bendin'"),
        ("lateral_bending@neck", "unknown part 'neck' in 'lateral_bending@neck'"),
        ("lateral_bending@levels", "'lateral_bending@levels' is a ratio for each level"),
    ],
)
def test_a_truth_of_what_has_no_ratio_is_refused_as_it_is_read(tmp_path, name, words):
    path = with_truth(tmp_path, **{"tissue": 0.05, name: 0.1})
    with pytest.raises(SubjectError) as refused:
        read_truth(path)
    assert str(refused.value).startswith(f"{path}: true ratios: ") and words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_truth_of_a_whole_and_its_part_is_refused(tmp_path):
    """Would the part's ratio be relative to the whole's, as in an estimate of both, or its own?"""
    path = with_truth(tmp_path, **{"tissue": 0.05, "lateral_bending": 0.1, "lateral_bending@lumbar": 2.0})
    with pytest.raises(SubjectError) as refused:
        read_truth(path)
    assert str(refused.value) == (
        f"{path}: holds true ratios of lateral_bending and of lateral_bending@lumbar, a part of it; wanted the whole's "
        "or its parts'"
    )


def test_a_truth_without_an_estimated_ratio_is_refused(made, tmp_path):
    with pytest.raises(SubjectError, match="holds no true ratio of lateral_bending"):
        compare_with_truth(*made, with_truth(tmp_path, tissue=0.05))


@pytest.mark.parametrize(
    "content",
    [
        "[]",
        '{"ratios": 3}',
        '{"ratios": {"tissue": "much"}}',
        '{"ratio": {}}',
        '{"ratios": {}}',
        '{"ratios": {"tissue": -0.0}}',
        '{"ratios": {"tissue": "0.2"}}',
        '{"ratios": {"tissue": true}}',
        '{"ratios": {"tissue": null}}',
    ],
)
def test_other_files_are_no_truth(finished, tmp_path, content):
    path = tmp_path / "truth.json"
    path.write_text(content)
    with pytest.raises(SubjectError, match="holds no true ratios"):
        read_truth(path)
    with pytest.raises(SubjectError, match="holds no true ratios"):
        open_visit(finished.folder, truth=path)
    with pytest.raises(SubjectError, match="no such file"):
        open_visit(finished.folder, truth=tmp_path / "none.json")
