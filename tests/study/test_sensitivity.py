"""Refits of an estimate with one thing changed: which, what comes out, and how a run goes on that was stopped."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from results import altered
from spinestiff.anatomy.regions import torso_ratios
from spinestiff.anatomy.stiffness import INTERVERTEBRAL_BENDING as BENDING
from spinestiff.anatomy.stiffness import RATIO_BOUNDS
from spinestiff.errors import FitError, SubjectError
from spinestiff.files import read_json
from spinestiff.study import sensitivity
from spinestiff.study.paper import TABLE_7
from spinestiff.study.refits import basis_of
from spinestiff.study.sensitivity import (
    LEVER_MM,
    Case,
    force_percent,
    leading_mode,
    paper_cases,
    sensitivity_study,
    weighed_cases,
    with_force,
)
from spinestiff.study.visit import Manner, Settings, open_visit, pushes_on
from spinestiff.study.wording.numbers import fixed
from spinestiff.study.wording.sensitivity import (
    estimator_columns,
    force_cells,
    force_lines,
    force_rows,
    ratio_cells,
    ratio_rows,
    sensitivity_lines,
    table_7_average,
    tornado_rows,
)
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.sensitivity_outcome import Refit, Sensitivity

COARSE = Settings(mesh="coarse")


def say(line):
    pass


@pytest.fixture
def visit(subject):
    return open_visit(subject, COARSE)


def told(series, what, by, **ratios):
    """A refit that costs nothing."""
    return Case(series, what, by, lambda start: ratios, {})


def test_force_and_stiffness_enter_an_equilibrium_by_their_ratio_alone(finished) -> None:
    """So 10 % of force is 10 % of stiffness, where one ratio scales every one; the pad's spring alone stays."""
    visit = open_visit(finished.folder, COARSE)
    torso, states = visit.torso(), []
    for factor in (1.0, 1.1):
        pushes = pushes_on(with_force(visit, factor), torso, Manner(method="paper"))
        item = pushes.training[-1]
        ratios = torso_ratios(torso, {"everything": 0.5 * factor})
        states.append(pushes.problems[item.push].solve(item.trial.load, ratios).require().state)
    one, other = (state.bone_positions[torso.vertebra_bones] for state in states)
    moved = one - torso.rest_pose.bone_positions[torso.vertebra_bones]
    assert np.abs(moved).max() > 0.5
    assert np.allclose(one, other, atol=5e-3 * np.abs(moved).max())
    found = with_refits(*[refit("everything", "force", f"{s}10 %", everything=10.0) for s in "−+"])
    assert force_lines(found)[0].startswith("with every stiffness scaled, 10 % of force is 10.0 % of stiffness")


def test_another_default_modulus_changes_the_ratio_and_not_the_stiffness(visit) -> None:
    asked = ("nothing", ""), ("default modulus", "+20 %")
    found = sensitivity_study(
        visit, say, lambda basis: [case for case in weighed_cases(basis) if (case.what, case.by) in asked]
    )
    _, stiffer = found.refits
    assert stiffer.percent["tissue"] == pytest.approx(100.0 * (1.0 / 1.2 - 1.0), abs=0.5)
    assert stiffer.stiffness_percent["tissue"] == pytest.approx(0.0, abs=0.5)
    assert stiffer.percent["lateral_bending"] == stiffer.stiffness_percent["lateral_bending"]
    assert stiffer.percent["lateral_bending"] == pytest.approx(0.0, abs=0.5)
    told = f"+20 % changes tissue by {fixed(stiffer.percent['tissue'], 0, True)} %"
    assert "−1" in told and any(told in line for line in sensitivity_lines(found))


def test_another_default_modulus_does_not_change_a_part_beside_its_whole(monkeypatch) -> None:
    """It is relative to the whole: +20 % on its own would show as a change of stiffness that nothing made."""
    monkeypatch.setattr(sensitivity, "with_force", lambda visit, factor: visit)
    visit = SimpleNamespace(subject=SimpleNamespace(pushes=()), settings=COARSE)
    monkeypatch.setattr(sensitivity, "has_start", lambda visit: False)
    for names, scaled in (
        (("tissue", "tissue@thorax"), {"tissue"}),
        (("lateral_bending", "tissue@thorax"), {"tissue@thorax"}),
    ):
        estimate = SimpleNamespace(orientation="procrustes", method="weighed", population=None)
        basis = SimpleNamespace(visit=visit, torso=None, estimate=estimate, names=names)
        cases = [case for case in weighed_cases(basis) if case.what == "default modulus"]
        assert [set(case.scale) for case in cases] == [scaled] * 2


def test_what_is_changed_reaches_the_trials(visit, monkeypatch) -> None:
    basis = basis_of(visit)
    fitted = []

    def kept(self, pushes, start=None):
        fitted.append(pushes)
        raise FitError("not fitted")

    monkeypatch.setattr(type(basis), "refit", kept)
    cases = list(weighed_cases(basis))
    assert [(case.what, case.by) for case in cases] == [
        ("nothing", ""),
        ("force", "−10 %"),
        ("force", "+10 %"),
        ("push level", "one rib higher"),
        ("push level", "one rib lower"),
        ("corners", "covariance"),
        ("default modulus", "−20 %"),
        ("default modulus", "+20 %"),
        ("geometry", "−1 sd of its leading mode"),
        ("geometry", "+1 sd of its leading mode"),
    ]
    for case in cases:
        with pytest.raises(FitError, match="not fitted"):
            case.fit(None)
    same, less, more, higher, lower, other, soft, stiff, back, forth = fitted
    force = same.training[-1].trial.load.size
    assert less.training[-1].trial.load.size == pytest.approx(0.9 * force)
    assert more.training[-1].trial.load.size == pytest.approx(1.1 * force)

    def height(pushes):
        load = pushes.training[-1].trial.load
        return np.linalg.norm(load.forces, axis=1) @ load.points.positions(pushes.torso.rest_pose)[:, 1] / load.size

    assert height(higher) > height(same) + 5.0 > height(lower) + 10.0
    assert (same.orientation, other.orientation) == ("procrustes", "covariance")
    assert np.allclose(stiff.torso.tissue.lame_mu, 1.5 * soft.torso.tissue.lame_mu)
    assert np.allclose(stiff.torso.tissue.lame_lambda, 1.2 * same.torso.tissue.lame_lambda)
    here, one, two = (p.torso.rest_pose.bone_positions[p.torso.vertebra_bones] for p in (same, back, forth))
    # Opposite ways, as far as springs bring the vertebrae to their places.
    assert np.abs(two - here).max() > 0.05
    assert np.allclose(two - here, here - one, atol=0.1 * np.abs(two - here).max())


def at_rib(visit, **levels):
    """The visit with all loaded frames in training, and pushes at other ribs."""

    def changed(push):
        roles = tuple("training" if force > 0.0 else "unused" for force in push.forces_n)
        return push.model_copy(update={"roles": roles, "level": levels.get(push.id, push.level)})

    pushes = tuple(changed(push) for push in visit.subject.pushes)
    return replace(
        visit, subject=replace(visit.subject, record=visit.subject.record.model_copy(update={"pushes": pushes}))
    )


def test_a_push_at_the_last_rib_stays_while_the_others_are_shifted(visit, monkeypatch) -> None:
    shifted = at_rib(visit, second=12.0)
    basis = replace(basis_of(visit), visit=shifted)
    heights = {}

    def kept(self, pushes, start=None):
        for item in pushes.training:
            load = item.trial.load
            up = load.points.positions(pushes.torso.rest_pose)[:, 1]
            heights.setdefault(item.push, []).append(np.linalg.norm(load.forces, axis=1) @ up / load.size)
        raise FitError("not fitted")

    monkeypatch.setattr(type(basis), "refit", kept)
    cases = [case for case in weighed_cases(basis) if case.what in ("nothing", "push level")]
    assert [case.by for case in cases] == ["", "one rib higher", "one rib lower"]
    for case in cases:
        with pytest.raises(FitError, match="not fitted"):
            case.fit(None)
    same, higher, lower = (heights["main"][::3][i] for i in range(3))
    assert higher > same + 5.0 > lower + 10.0
    same, higher, lower = heights["second"]
    # The last rib is short, and ends hardly lower than the one before it.
    assert abs(higher - same) > 1.0
    assert lower == same
    found = sensitivity_study(shifted, say, lambda basis: [told("weighed", "nothing", "", tissue=0.05)])
    assert [note for note in found.notes if note.startswith("push level")] == [
        "push level: there is no rib 13 to push at ('second'): it stays at rib 12 while others are pushed one rib lower"
    ]
    monkeypatch.undo()
    alone = replace(basis, visit=at_rib(visit, main=1.0, second=1.0))
    levels = [case.by for case in weighed_cases(alone) if case.what == "push level"]
    assert levels == ["one rib lower"]
    found = sensitivity_study(alone.visit, say, lambda basis: [told("weighed", "nothing", "", tissue=0.05)])
    assert "push level: there is no rib 0 to push at ('main'): no refit is one rib higher" in found.notes


def test_what_a_stopped_run_left_is_made_anew_where_all_is_asked_for_again(visit) -> None:
    made = []

    def refit(by, fails=False):
        def fit(start):
            if fails:
                raise KeyboardInterrupt
            made.append(by)
            return {"tissue": 0.05}

        return Case("weighed", "force" if by else "nothing", by, fit, {})

    with pytest.raises(KeyboardInterrupt):
        sensitivity_study(visit, say, lambda basis: [refit(""), refit("+10 %", fails=True)])
    again = replace(visit, settings=replace(visit.settings, redo=True))
    sensitivity_study(again, say, lambda basis: [refit(""), refit("+10 %")])
    assert made == ["", "", "+10 %"]


def test_a_run_that_was_stopped_goes_on_where_it_was(visit) -> None:
    made = []

    def refit(by, fails=False):
        def fit(start):
            if fails:
                raise KeyboardInterrupt
            made.append(by)
            return {"tissue": 0.05 if by == "" else 0.06}

        return Case("weighed", "force" if by else "nothing", by, fit, {})

    with pytest.raises(KeyboardInterrupt):
        sensitivity_study(visit, say, lambda basis: [refit(""), refit("+10 %"), refit("−10 %", fails=True)])
    written = read_json(visit.file("sensitivity.json"))
    assert [one["by"] for one in written["refits"]] == ["", "+10 %"]
    assert written["complete"] is False
    found = sensitivity_study(visit, say, lambda basis: [refit(""), refit("+10 %"), refit("−10 %")])
    assert made == ["", "+10 %", "−10 %"]
    assert found.complete
    assert found.refits[1].percent["tissue"] == pytest.approx(20.0)
    # A run that is asked for again makes all of them again.
    sensitivity_study(visit, say, lambda basis: [refit("")])
    assert made == ["", "+10 %", "−10 %", ""]
    # Refits on another mesh are none of these.
    finer = replace(visit, settings=Settings(mesh="fine"))
    with pytest.raises(SubjectError, match=r"torso\.npz: was shaped on the coarse mesh alone"):
        sensitivity_study(finer, say, lambda basis: [refit("")])


def test_refits_made_while_there_was_nothing_to_compare_them_with_are_made_anew(visit) -> None:
    """A run is stopped in which the refit with nothing changed had failed, and goes on to one in which it does not."""
    fails = {"": FitError("no equilibrium"), "−10 %": KeyboardInterrupt()}

    def refit(by):
        def fit(start):
            if by in fails:
                raise fails[by]
            return {"tissue": 0.05 if by == "" else 0.06}

        return Case("weighed", "force" if by else "nothing", by, fit, {})

    cases = [refit(""), refit("+10 %"), refit("−10 %")]
    with pytest.raises(KeyboardInterrupt):
        sensitivity_study(visit, say, lambda basis: cases)
    fails.clear()
    found = sensitivity_study(visit, say, lambda basis: cases)
    assert found.complete
    assert [one.percent.get("tissue") for one in found.refits] == pytest.approx([0.0, 20.0, 20.0])
    assert found.force_percent["weighed"] == pytest.approx({"tissue": 20.0})


def test_refits_of_another_estimate_are_not_gone_on_with(visit) -> None:
    made = []

    def stopped(start):
        raise KeyboardInterrupt

    def fit(start):
        made.append(1)
        return {"tissue": 0.05}

    cases = [Case("weighed", "nothing", "", fit, {}), Case("weighed", "force", "+10 %", stopped, {})]
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            sensitivity_study(visit, say, lambda basis: cases)
    assert len(made) == 1
    altered(visit.subject.folder, Estimate, lambda content: content.update(notes=["made again"]))
    with pytest.raises(KeyboardInterrupt):
        sensitivity_study(open_visit(visit.subject.folder, COARSE), say, lambda basis: cases)
    assert len(made) == 2


def test_refits_by_other_sources_of_the_same_version_are_not_gone_on_with(visit, monkeypatch) -> None:
    made = []

    def stopped(start):
        raise KeyboardInterrupt

    def fit(start):
        made.append(1)
        return {"tissue": 0.05}

    cases = [Case("weighed", "nothing", "", fit, {}), Case("weighed", "force", "+10 %", stopped, {})]
    for sources in ("these", "these", "others"):
        monkeypatch.setattr(
            "spinestiff.study.sensitivity.program_of_numbers", lambda sources=sources: f"0.1.0+{sources}"
        )
        with pytest.raises(KeyboardInterrupt):
            sensitivity_study(visit, say, lambda basis: cases)
    assert len(made) == 2


def test_a_refit_that_fails_is_told_and_the_others_go_on(visit) -> None:
    def fails(start):
        raise FitError("no equilibrium anywhere")

    cases = [
        told("weighed", "nothing", "", tissue=0.05),
        Case("weighed", "corners", "covariance", fails, {}),
        told("weighed", "push level", "one rib lower", tissue=0.04),
    ]
    found = sensitivity_study(visit, say, lambda basis: cases)
    assert [len(one.ratios) for one in found.refits] == [1, 0, 1]
    assert "no estimate with corners covariance: no equilibrium anywhere" in sensitivity_lines(found)
    assert [title for title, _ in tornado_rows(found)] == ["push level ±1 rib"]


def test_refits_start_from_the_one_with_nothing_changed(visit) -> None:
    starts = []

    def noted(start):
        starts.append(start)
        return {"tissue": 0.05}

    cases = [Case("tied", "nothing", "", noted, {}), Case("tied", "force", "+10 %", noted, {})]
    sensitivity_study(visit, say, lambda basis: cases)
    assert starts == [None, {"tissue": 0.05}]


def test_an_estimate_by_the_papers_method_is_refused(visit) -> None:
    altered(visit.subject.folder, Estimate, lambda content: content.update(method="paper"))
    with pytest.raises(SubjectError, match="is by the paper's method"):
        basis_of(open_visit(visit.subject.folder, COARSE))


def test_the_papers_refits_are_of_its_two_ratios_and_of_one_for_all(finished) -> None:
    cases = list(paper_cases(basis_of(open_visit(finished.folder, COARSE))))
    assert [(case.series, case.by) for case in cases] == [
        *[(series, by) for series in ("tied", "kept") for by in ("", "other ratios", "−10 %", "+10 %")],
        *[("everything", by) for by in ("", "−10 %", "+10 %")],
    ]


def test_one_of_the_papers_refits_begins_elsewhere(finished, monkeypatch) -> None:
    starts = []

    def noted(pushes, names, start, method):
        starts.append((method, tuple(start.items())))
        raise FitError("not fitted")

    monkeypatch.setattr("spinestiff.study.sensitivity.fit_pushes", noted)
    there = {BENDING: 0.1, "tissue": 0.02}
    for case in list(paper_cases(basis_of(open_visit(finished.folder, COARSE))))[:4]:
        with pytest.raises(FitError, match="not fitted"):
            case.fit(there)
    same = ("paper", tuple(there.items()))
    elsewhere = ("paper", ((BENDING, pytest.approx(0.12)), ("tissue", pytest.approx(0.014))))
    assert starts == [same, elsewhere, same, same]


def test_a_refit_that_begins_elsewhere_stays_inside_the_bounds(finished, monkeypatch) -> None:
    def noted(pushes, names, start, method):
        starts.append(tuple(start.values()))
        raise FitError("not fitted")

    starts: list[tuple[float, ...]] = []
    monkeypatch.setattr("spinestiff.study.sensitivity.fit_pushes", noted)
    low, high = RATIO_BOUNDS
    case = next(c for c in paper_cases(basis_of(open_visit(finished.folder, COARSE))) if c.by == "other ratios")
    with pytest.raises(FitError, match="not fitted"):
        case.fit({BENDING: 0.9 * high, "tissue": 1.1 * low})
    assert starts == [(high, low)]


def refit(series, what, by, **percent):
    return Refit(
        series=series, what=what, by=by, ratios=percent and {"x": 1.0}, percent=percent, stiffness_percent=percent
    )


def with_refits(*refits):
    return Sensitivity(
        basis="", mesh="coarse", parameters=("lateral_bending", "tissue"), estimate={}, interval95={},
        refits=refits, force_percent=force_percent(refits), complete=True,
    )  # fmt: skip


def test_a_sensitivity_to_force_is_the_mean_of_both_signs() -> None:
    both = refit("kept", "force", "−10 %", tissue_mu=-20.0), refit("kept", "force", "+10 %", tissue_mu=30.0)
    assert force_percent(both) == {"kept": {"tissue_mu": 25.0}}
    assert force_percent(both[:1]) == {}


def test_the_paper_stands_beside_as_it_is_printed() -> None:
    assert round(table_7_average(BENDING), 1) == 7.6
    assert round(table_7_average("tissue_mu"), 1) == 28.6
    assert len(TABLE_7[BENDING]) == len(TABLE_7["tissue_mu"]) == 7
    assert force_rows(with_refits())[-1][1] == {name: table_7_average(name) for name in TABLE_7}


@pytest.mark.parametrize(
    ("bending", "mu", "words"),
    [
        (8.0, 30.0, "a lambda that stays makes mu more sensitive here, 2.5 times tissue's with lambda tied"),
        (2.0, 13.0, "a lambda that stays hardly changes how sensitive mu is here, 1.1 times tissue's with lambda tied, "
         "and bending less"),
        (21.0, 6.0, "a lambda that stays makes mu less sensitive here, 0.50 times tissue's with lambda tied, and "
         "bending more: it takes over what lambda does not follow"),
    ],
)  # fmt: skip
def test_what_a_lambda_that_stays_does_is_told_as_it_was_found(bending, mu, words) -> None:
    tied = [refit("tied", "force", f"{sign}10 %", intervertebral_bending=8.0, tissue=12.0) for sign in "−+"]
    kept = [refit("kept", "force", f"{sign}10 %", intervertebral_bending=bending, tissue_mu=mu) for sign in "−+"]
    assert force_lines(with_refits(*tied, *kept))[-1] == words


def test_a_search_that_ends_where_it_began_is_told_and_no_verdict_is_made() -> None:
    tied = [refit("tied", "force", f"{sign}10 %", intervertebral_bending=8.0, tissue=12.0) for sign in "−+"]
    kept = [refit("kept", "force", f"{sign}10 %", intervertebral_bending=21.0, tissue_mu=9.0) for sign in "−+"]
    sure = refit("tied", "start", "other ratios", intervertebral_bending=0.1, tissue=0.2)
    loose = refit("kept", "start", "other ratios", intervertebral_bending=10.0, tissue_mu=-29.0)
    lines = force_lines(with_refits(*tied, sure, *kept, loose))
    assert lines[-2:] == [
        "equal weights, lambda kept at its default: a search begun at other ratios ends elsewhere, "
        "intervertebral_bending +10 % and tissue_mu −29 %, so that its row is known no better than that",
        "what a lambda that stays does to mu's sensitivity can't be told here by equal weights",
    ]
    assert not any("ends elsewhere" in line for line in force_lines(with_refits(*tied, sure, *kept)))


def test_the_papers_estimator_stands_beside_with_what_it_estimates() -> None:
    ours, changed = (refit("weighed", what, "", lateral_bending=0.0) for what in ("nothing", "force"))
    paper, failed = refit("kept", "nothing", "", intervertebral_bending=0.0), refit("tied", "nothing", "")
    ratios = {"intervertebral_bending": 0.1508, "tissue_mu": 0.003318}
    found = with_refits(ours, changed, failed, paper.model_copy(update={"ratios": ratios}))
    assert ratio_rows(found) == [
        ("weighed, the estimate's ratios", {"x": 1.0}), ("equal weights, lambda kept at its default", ratios)
    ]  # fmt: skip
    assert ratio_cells(ratios, estimator_columns(found)) == ("0.151", "0.00332", "")


def test_ratios_of_parts_have_rows_and_other_groups_columns_of_their_own() -> None:
    """They were estimated, and stood in no cell."""
    ratios = {"lateral_bending@T8-T9": 0.1, "tissue@abdomen": 0.02, "axial_rotation": 0.5, "tissue@thorax": 0.03}
    weighed = refit("weighed", "nothing", "").model_copy(update={"ratios": ratios})
    forces = [refit("weighed", "force", f"{sign}10 %", **dict.fromkeys(ratios, 9.0)) for sign in "−+"]
    found = with_refits(weighed, *forces).model_copy(update={"parameters": tuple(ratios)})
    columns = estimator_columns(found)
    assert tuple(columns) == ("bending", "tissue", "everything", "axial rotation")
    assert [(label, ratio_cells(values, columns)) for label, values in ratio_rows(found)] == [
        ("weighed, the estimate's ratios", ("", "", "", "0.500")),
        ("weighed, lateral_bending@T8-T9", ("0.100", "", "", "")),
        ("weighed, tissue@abdomen", ("", "0.0200", "", "")),
        ("weighed, tissue@thorax", ("", "0.0300", "", "")),
    ]
    assert [force_cells(values, columns) for _, values in force_rows(found)][:2] == [
        ("", "", "", "9.0"),
        ("9.0", "", "", ""),
    ]


def test_rows_come_with_the_largest_change_first() -> None:
    found = with_refits(
        refit("weighed", "force", "+10 %", tissue=12.0, lateral_bending=-9.0),
        refit("weighed", "push level", "one rib lower", tissue=-3.0, lateral_bending=40.0),
        refit("tied", "force", "+10 %", tissue=90.0),
    )
    assert [title for title, _ in tornado_rows(found)] == ["push level ±1 rib", "force ±10 %"]
    assert (
        "largest change of each stiffness: lateral_bending +40 % (push level one rib lower); tissue +12 %"
        in (sensitivity_lines(found)[0])
    )


def test_the_estimates_own_interval_stands_beside() -> None:
    found = with_refits().model_copy(
        update={"estimate": {"lateral_bending": 0.2, "tissue": 0.05}, "interval95": {"lateral_bending": (0.1, 0.5)}}
    )
    assert sensitivity_lines(found) == [
        "for comparison, the estimate's own 95 % interval about its value: lateral_bending −50 % to +150 %"
    ]
    bounded = found.model_copy(update={"open_ends": {"lateral_bending": (True, False)}})
    assert sensitivity_lines(bounded)[0].endswith(": lateral_bending ≤ −50 % to +150 %")


def test_an_end_at_the_fits_bound_is_told_as_open(visit) -> None:
    def opened(content) -> None:
        content["ratios"]["tissue"]["open_low"] = True

    altered(visit.subject.folder, Estimate, opened)
    found = sensitivity_study(visit, say, lambda basis: [told("weighed", "nothing", "", tissue=0.05)])
    assert found.open_ends == {"tissue": (True, False)}
    assert any(": lateral_bending" in line and "tissue ≤ −" in line for line in sensitivity_lines(found))


def test_the_leading_mode_of_a_spine_is_a_shape_and_no_motion_as_one_body() -> None:
    heights = np.linspace(0.0, 400.0, 9)
    positions = np.stack([np.zeros(9), heights, np.zeros(9)], axis=1)
    shape = np.zeros((9, 6))
    shape[:, 0] = np.cos(np.linspace(0.0, 2.0 * np.pi, 9))
    shape[:, 0] -= np.polyval(np.polyfit(heights, shape[:, 0], 1), heights)
    turned = np.zeros((9, 6))
    turned[:, :3] = np.cross([0.0, 0.0, 1.0], positions)
    turned[:, 5] = 1.0
    shifted = np.zeros((9, 6))
    shifted[:, 1] = 1.0
    whole = sum(np.outer(m.reshape(-1), m.reshape(-1)) for m in (2.0 * shape, 0.5 * turned, 50.0 * shifted))
    found = leading_mode(np.asarray(whole), positions)
    apart = found.reshape(-1)
    units = np.tile([1.0] * 3 + [LEVER_MM] * 3, 9)
    for motion in (turned, shifted):
        assert abs((apart * units) @ (motion.reshape(-1) * units)) < 1e-6 * np.linalg.norm(motion.reshape(-1) * units)
    against = found[:, 0] @ shape[:, 0] / np.linalg.norm(found[:, 0]) / np.linalg.norm(shape[:, 0])
    assert abs(against) > 0.99
    assert np.abs(found[:, 0]).max() == pytest.approx(2.0 * np.abs(shape[:, 0]).max(), rel=0.05)
    # The same whichever sign an eigenvector comes with.
    assert np.array_equal(found, leading_mode(np.asarray(whole), positions))
    assert found.reshape(-1)[np.argmax(np.abs(found * units.reshape(9, 6)))] > 0.0


def test_refits_without_one_to_compare_with_are_not_drawn():
    """Where the refit with nothing changed failed, the others have ratios and no percent."""
    refits = [
        SimpleNamespace(series="weighed", what="force", ratios={"tissue": 0.1}, stiffness_percent={}),
        SimpleNamespace(series="weighed", what="mesh", ratios={"tissue": 0.1}, stiffness_percent={"tissue": 3.0}),
    ]
    rows = tornado_rows(SimpleNamespace(refits=refits))
    assert [[one.what for one in own] for _, own in rows] == [["mesh"]]
