"""Reading a visit's results: truth, regions, plain units, warnings and Cobb angles."""

from __future__ import annotations

import json

import numpy as np
import pytest
from spinestiff.study.pipeline import run_steps

from spinestiff.anatomy.files import read_torso
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import SubjectError
from spinestiff.files import read_json, write_json
from spinestiff.mechanics.equilibrium import Equilibrium, SolveStatus
from spinestiff.mechanics.supports import Reaction
from spinestiff.study.visit import (
    Settings,
    cobb_frames,
    cobb_rows,
    compare_with_truth,
    estimated_ratios,
    load_pushes,
    load_tracked,
    open_visit,
    plain_stiffness,
    read_truth,
    support_warnings,
    truth_in_region,
)


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


def with_truth(tmp_path, **ratios):
    path = tmp_path / "other.truth.json"
    write_json(path, {"ratios": ratios})
    return path


def compared(folder, truth):
    visit = open_visit(folder, truth=truth)
    return compare_with_truth(visit, load_pushes(visit, read_torso(visit.file("torso.npz"))))


def test_the_truth_is_measured_on_the_model(finished, tmp_path):
    """At the estimate itself the distance is 0; for truths near it the linear answer; far off it is outside."""
    fit = finished.fit
    at_estimate = compared(finished.folder, with_truth(tmp_path, **fit.ratios.as_dict()))
    assert at_estimate["distance2"] < 1e-6
    assert at_estimate["inside"] is True
    direction = np.linalg.cholesky(fit.uncertainty.covariance) @ np.array([0.6, 0.8])
    near = dict(zip(fit.names, np.exp(np.log(fit.ratios.values) + 0.003 * direction).tolist()))
    assert compared(finished.folder, with_truth(tmp_path, **near))["distance2"] == pytest.approx(0.003**2, rel=0.15)
    stiff = compared(finished.folder, with_truth(tmp_path, lateral_bending=1.0, tissue=1.0))
    assert stiff["distance2"] > stiff["region_size"]
    assert stiff["inside"] is False


def test_assess_writes_the_comparison_and_others_read_it(subject, finished, tmp_path):
    visit = open_visit(subject, truth=finished.truth)
    run_steps(visit, ("assess",))
    record = read_json(visit.file("comparison.json"))
    assert record["inside"] is (record["distance2"] <= record["region_size"])
    assert truth_in_region(visit) is record["inside"]
    another = open_visit(subject, truth=with_truth(tmp_path, lateral_bending=0.3, tissue=0.05))
    assert truth_in_region(another) is None


def test_no_truth_no_answer(finished, subject):
    assert truth_in_region(open_visit(finished.folder)) is None
    assert compared(finished.folder, None) is None
    record = read_json(subject / "results" / "estimate.json")
    write_json(subject / "results" / "estimate.json", {**record, "covariance_log": [[None, None], [None, None]]})
    assert compared(subject, finished.truth)["inside"] is None


def test_a_truth_without_an_estimated_ratio_is_refused(finished, tmp_path):
    with pytest.raises(SubjectError, match="holds no true ratio of lateral_bending"):
        compared(finished.folder, with_truth(tmp_path, tissue=0.05))


@pytest.mark.parametrize("content", ["[]", '{"ratios": 3}', '{"ratios": {"tissue": "much"}}', '{"ratio": {}}'])
def test_other_files_are_no_truth(finished, tmp_path, content):
    path = tmp_path / "truth.json"
    path.write_text(content)
    with pytest.raises(SubjectError, match="holds no true ratios"):
        read_truth(path)
    with pytest.raises(SubjectError, match="holds no true ratios"):
        open_visit(finished.folder, truth=path)
    with pytest.raises(SubjectError, match="no such file"):
        open_visit(finished.folder, truth=tmp_path / "none.json")


@pytest.mark.parametrize("wrong", [{"mesh": "huge"}, {"method": "guess"}, {"orientation": "upright"}])
def test_unknown_settings_are_refused(wrong):
    ((what, value),) = wrong.items()
    with pytest.raises(SubjectError, match=f"unknown {what} '{value}'; wanted one of "):
        Settings(**wrong)


def test_ratios_are_read_back(finished, torso):
    assert estimated_ratios(open_visit(finished.folder), torso).as_dict() == finished.fit.ratios.as_dict()


@pytest.mark.parametrize(
    "damage",
    [
        lambda entry: entry["frames"].pop(),
        lambda entry: entry.pop("view"),
        lambda entry: entry["frames"][1].pop("quality"),
        lambda entry: entry["frames"][1].update(corners_px="none"),
    ],
)
def test_a_tracked_file_of_another_push_is_refused(subject, damage):
    path = subject / "results" / "tracked.json"
    record = read_json(path)
    damage(record["pushes"]["main"])
    write_json(path, record)
    with pytest.raises(SubjectError, match=r"does not fit push 'main' \(.*\); run spinestiff track again"):
        load_tracked(open_visit(subject))


def test_plain_units(torso):
    """Of bending the spine's mean of each part; of tissue E = mu (3 lambda + 2 mu) / (lambda + mu)."""
    kinds = torso.joints.kinds
    default = plain_stiffness(torso, stiffness_ratios({}, kinds))
    mu, lam = float(torso.tissue.lame_mu[0]), float(torso.tissue.lame_lambda[0])
    assert default["tissue_young_kpa"] == pytest.approx(1e3 * mu * (3.0 * lam + 2.0 * mu) / (lam + mu))
    rows = [k == "lumbar" for k in kinds]
    assert default["lateral_bending_lumbar_nm_per_rad"] == pytest.approx(torso.joints.stiffness[rows, 5].mean() / 1e3)
    softer = plain_stiffness(torso, stiffness_ratios({"lateral_bending": 0.1, "tissue": 0.02}, kinds))
    for name, value in softer.items():
        assert value == pytest.approx(default[name] * (0.02 if "tissue" in name else 0.1)), name


def equilibrium(torso, reactions=(), pelvis_deg=0.0):
    rest, pelvis = torso.rest_pose, torso.bone("pelvis")
    rotations = rest.bone_rotations.copy()
    rotations[pelvis] = exp_so3(np.array([0.0, 0.0, np.radians(pelvis_deg)])) @ rotations[pelvis]
    state = TorsoState(rest.bone_positions, rotations, rest.tissue_positions)
    named = [("shoulder", (0, 0, 0)), *reactions]
    found = tuple(Reaction(name, np.zeros(3), np.array(force), np.zeros(3)) for name, force in named)
    return Equilibrium(state, SolveStatus.CONVERGED, 0.0, 0.0, 1e-8, found, (), 0, 1.0)


@pytest.mark.parametrize(("side", "push"), [("right", 1.0), ("left", -1.0)])
def test_supports_that_pull_are_told(torso, side, push):
    """A push to +x is borne by a shoulder that pushes to -x; the wall behind can only push forward."""
    held = equilibrium(torso, [("shoulder", (-10.0 * push, 0, 0)), ("wall_T5", (0, 0, 4.0))])
    assert support_warnings(held, torso, side) == []
    pulled = equilibrium(torso, [("shoulder", (3.0 * push, 0, 0))])
    assert support_warnings(pulled, torso, side) == ["the shoulder's support pulls with 3.0 N"]


def test_a_wall_that_pulls_and_a_tilted_pelvis_are_told(torso):
    found = equilibrium(torso, [("wall_R5_L", (0, 0, -2.5)), ("wall_R6_L", (0, 0, -7.0)), ("wall_R7_L", (0, 0, -1.0))])
    (warning,) = support_warnings(found, torso, "right")
    assert warning.startswith("the back wall pulls at 2 points (most at R6_L, 7.0 N)")
    assert support_warnings(equilibrium(torso, pelvis_deg=-4.0), torso, "right") == [
        "the pelvis tilts by -4.0 degrees (limit 3)"
    ]
    assert support_warnings(equilibrium(torso, pelvis_deg=2.0), torso, "right") == []


def test_cobb_rows(finished, subject):
    rows = cobb_rows(cobb_frames(open_visit(finished.folder)))
    assert [row[0] for row in rows] == [
        "rest/frontal",
        "main frame 0, 0 N",
        "main frame 1, 15 N",
        "main frame 2, 22 N",
        "main frame 3, 30 N",
        "second frame 0, 0 N",
        "second frame 1, 30 N",
    ]
    assert rows[0][1].startswith("+1")  # a left curve of 12 degrees or a little more
    assert "convexity left" in rows[0][1]
    assert rows[0][2:] == ("", "", "")
    assert rows[1][2:] == ("+0.0", "+0.0", "+0.0")
    truth = json.loads(finished.truth.read_text())["pushes"]["main"][3]["cobb_change_deg"]
    signed, fixed, tilt = (float(value) for value in rows[4][2:])
    assert tilt == pytest.approx(truth["tilt"], abs=2.5)
    assert tilt < -1.0
    assert fixed < 0.0
    assert signed < 0.0
    (subject / "results" / "tracked.json").unlink()
    assert cobb_rows(cobb_frames(open_visit(subject))) == rows[:1]
