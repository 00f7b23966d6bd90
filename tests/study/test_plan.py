"""Which push to take next: of a subject with an estimate, and of one before any push."""

from __future__ import annotations

import re
import weakref
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from spinestiff.anatomy.regions import parameter_groups
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import EquilibriumError, SubjectError
from spinestiff.estimation.evaluation import TrialSet
from spinestiff.estimation.known import Known
from spinestiff.estimation.objective import SkinMarkers
from spinestiff.files import read_json, write_json
from spinestiff.imaging.features import silhouette_shares, state_features, view_kind
from spinestiff.imaging.projection import frontal_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.push import Rig
from spinestiff.mechanics.sensitivity import Linearisation
from spinestiff.study.draws import DRAWS_FILE, read_draws
from spinestiff.study.planning import proposal, states, widths
from spinestiff.study.planning.proposal import make_plan
from spinestiff.study.planning.scene import PLACES, Scene, places_of_draws, population_places, scene_of
from spinestiff.study.planning.wish import Frame, Wish
from spinestiff.study.report.protocol import protocol_page
from spinestiff.study.runner import run_steps
from spinestiff.study.synthetic.markers import spread_markers
from spinestiff.study.visit import Settings, open_visit
from spinestiff.study.wording.plan import now_of, pays, plan_lines, size_of
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.run_record import read_outcome

SMALL = Wish(limit_n=30.0, exposures=5, sides=("left", "right"), ribs=(6.0, 8.0))
SITE = replace(SMALL, sides=("left",), ribs=(8.0,))
FRONTAL = replace(SITE, views=("frontal",))


@pytest.fixture(scope="module")
def scene(finished):
    """The finished subject with its estimate, at two places."""
    found = scene_of(open_visit(finished.folder))
    assert found.places.shape == (PLACES, 2)
    return replace(found, places=found.places[[1, 3]])


@pytest.fixture(scope="module")
def one(scene):
    """The same at one place."""
    return replace(scene, places=scene.places[:1])


@pytest.fixture(scope="module")
def solved(scene):
    """What any plan of ``SMALL`` or a part of it is composed from: the pushes in equilibrium, and what they tell."""
    carried = states.CarriedPushes(scene, SMALL)
    return carried, widths.ExpectedWidths(scene, carried)


@pytest.fixture(scope="module")
def plan(scene, solved):
    return proposal.composed(scene, SMALL, *solved)


@pytest.fixture(scope="module")
def alone(scene):
    """The plan of one site and view, from equilibria of its own."""
    return make_plan(scene, FRONTAL)


def test_single_pushes_come_best_first_and_all_of_them_narrow(plan) -> None:
    factors = [push.expected_factor for push in plan.next]
    assert factors == sorted(factors)
    assert [push.view for push in plan.next].count("frontal") == 8
    assert len({(push.side, push.level, push.force_n, push.view) for push in plan.next}) == len(plan.next) == 16
    assert 1.0 < factors[0] <= factors[-1] < plan.now["lateral_bending"]
    for push in plan.next:
        assert push.factors["lateral_bending"] == push.expected_factor
        assert push.factors["tissue"] < plan.now["tissue"]
        assert push.radiographs == (2 if push.view == "frontal" else 4)
        same = [one for one in plan.next if one.expected_factor == push.expected_factor]
        assert [one.radiographs for one in same] == sorted(one.radiographs for one in same)


def test_what_a_tape_brings_before_any_push_is_told_of_the_push_that_is_called_best() -> None:
    """The narrowest single push takes lateral radiographs, too; the first step of the sequence doesn't."""
    torso = template_torso(157.0, "coarse")
    middle = torso.rest_pose.bone_positions[torso.vertebra_bones][[0, -1]].mean(0) * [0.0, 1.0, 0.0]
    known = Known(geometry=1e-4 * np.eye(6 * len(torso.vertebrae)))
    seen, names = torso.vertebrae[2:16], ("lateral_bending", "tissue")
    scene = Scene(torso, known, Rig(), frontal_view(centre=middle), seen, names, population_places()[:1])
    wish = Wish(limit_n=40.0, exposures=6, sides=("left",), ribs=(8.0,))
    carried = states.CarriedPushes(scene, wish)
    expected = widths.ExpectedWidths(scene, carried)
    both, alone = (
        proposal.composed(scene, asked, carried, expected) for asked in (wish, replace(wish, views=("frontal",)))
    )
    assert (both.next[0].view, both.sequence[0].push.view) == ("frontal+lateral", "frontal")
    assert both.sequence[0].push.expected_factor == alone.sequence[0].push.expected_factor
    assert both.taped == alone.taped


def test_a_plan_holds_a_tangent_a_thread_and_is_that_of_all_at_once(one, monkeypatch) -> None:
    alive, most = weakref.WeakSet(), [0]
    begin = Linearisation.__init__

    def counted(self, *args, **kwargs):
        begin(self, *args, **kwargs)
        alive.add(self)
        most[0] = max(most[0], len(alive))

    monkeypatch.setattr(Linearisation, "__init__", counted)
    monkeypatch.setenv("SPINESTIFF_THREADS", "1")
    carried = states.CarriedPushes(one, FRONTAL)
    found = proposal.composed(one, FRONTAL, carried, widths.ExpectedWidths(one, carried))
    assert most[0] == 1
    monkeypatch.setattr(widths, "_OneByOne", lambda *trials: TrialSet(*trials, None))
    assert proposal.composed(one, FRONTAL, carried, widths.ExpectedWidths(one, carried)) == found
    assert most[0] >= 4


def test_a_frontal_radiograph_is_worth_the_same_whether_or_not_lateral_ones_are_compared(plan, alone) -> None:
    both = {(p.side, p.level, p.force_n): p.expected_factor for p in plan.next if p.view == "frontal"}
    assert {(p.side, p.level, p.force_n, p.view) for p in alone.next} == {
        ("left", 8.0, force, "frontal") for force in (15.0, 30.0)
    }
    assert alone.now == pytest.approx(plan.now, abs=0.002)
    for push in alone.next:
        assert push.expected_factor == pytest.approx(both[push.side, push.level, push.force_n], abs=0.002)
    assert "lateral radiograph" not in " ".join(plan_lines(alone))
    assert "with a lateral radiograph beside each: within a factor of" in " ".join(plan_lines(plan))


def test_a_narrower_wish_is_answered_from_the_same_equilibria(scene, solved, alone) -> None:
    narrow = proposal.composed(scene, FRONTAL, *solved)
    assert [(p.side, p.force_n) for p in narrow.next] == [(p.side, p.force_n) for p in alone.next]
    assert {push.side for push in narrow.next} == {step.push.side for step in narrow.sequence} == {"left"}
    assert [p.expected_factor for p in narrow.next] == pytest.approx([p.expected_factor for p in alone.next], abs=0.002)
    assert len(narrow.sequence) == len(alone.sequence)
    with pytest.raises(EquilibriumError, match="no push of 15 to 30 N leaves all vertebrae within 45 degrees"):
        proposal.composed(scene, replace(FRONTAL, ribs=(7.0,)), *solved)


def test_all_views_of_a_push_are_taken_once(scene, solved) -> None:
    """Two forces from two sides and unloaded: a lateral radiograph adds itself to a frontal one that is there."""
    every = proposal.composed(scene, replace(SITE, exposures=12), *solved)
    assert sum(step.push.radiographs for step in every.sequence) == every.sequence[-1].exposures == 6
    seen: set[tuple[float, str]] = set()
    for step in every.sequence:
        push = step.push
        wanted = {(force, view) for force in (0.0, push.force_n) for view in push.view.split("+")}
        assert push.radiographs == len(wanted - seen)
        seen |= wanted
    assert len(seen) == 6


def test_a_lateral_radiograph_may_cost_more(scene, solved) -> None:
    wish = replace(SITE, views=("frontal+lateral",))
    with pytest.raises(SubjectError, match=r"exposures for 7 frontal .* as frontal\+lateral takes 8"):
        replace(wish, exposures=7, lateral_cost=3.0)
    dear, cheap = (
        proposal.composed(scene, replace(wish, exposures=8, lateral_cost=cost), *solved) for cost in (3.0, 1.0)
    )
    assert [step.exposures for step in dear.sequence] == [4]
    assert [step.exposures for step in cheap.sequence] == [4, 6]
    for cost in (0.0, float("inf"), float("nan")):
        with pytest.raises(SubjectError, match="wanted a number above 0"):
            replace(wish, lateral_cost=cost)


def test_a_lateral_radiograph_tells_of_the_vertebrae_that_it_shows(one) -> None:
    assert view_kind(one.lateral) == "lateral"
    few = replace(one, marked_aside=one.aside[-3:])
    plans = [make_plan(seen, replace(SITE, exposures=2)) for seen in (few, replace(few, marked_aside=None))]
    fewer, all_of_them = ({(push.view, push.force_n): push.factors["tissue"] for push in plan.next} for plan in plans)
    assert fewer["frontal", 30.0] == all_of_them["frontal", 30.0]
    assert fewer["frontal+lateral", 30.0] > all_of_them["frontal+lateral", 30.0]


def test_axial_rotation_is_a_target_where_it_is_estimated(scene) -> None:
    wish = replace(FRONTAL, target="rotation", exposures=4)
    with pytest.raises(SubjectError, match=r"no ratio axial_rotation .* with axial_rotation among its --parameters"):
        make_plan(scene, wish)
    places = np.column_stack([scene.places, np.zeros(len(scene.places))])[:1]
    found = make_plan(replace(scene, names=(*scene.names, "axial_rotation"), places=places), wish)
    assert found.next[0].expected_factor == found.next[0].factors["axial_rotation"] < found.now["axial_rotation"]
    assert plan_lines(found)[0].startswith("axial rotation: now within a factor of")


def test_the_whole_force_tells_more_than_half_of_it(plan) -> None:
    frontal = [push for push in plan.next if push.view == "frontal"]
    of = {(push.side, push.level, push.force_n): push.expected_factor for push in frontal}
    for side in ("left", "right"):
        for rib in (6.0, 8.0):
            assert of[side, rib, 30.0] < of[side, rib, 15.0]


def test_a_sequence_begins_with_the_best_and_counts_unloaded_radiographs(plan) -> None:
    first = plan.sequence[0]
    # By what it narrows for each exposure, so that of its own view none is narrower.
    assert first.push == next(push for push in plan.next if push.view == first.push.view)
    assert first.exposures == 2
    sizes = [step.push.expected_factor for step in plan.sequence]
    assert sizes == sorted(sizes, reverse=True)
    pushes, count = set(), 0
    for step in plan.sequence:
        mine = step.push.side, step.push.level
        count += 1 if mine in pushes else 2
        pushes.add(mine)
        assert step.exposures == count
    assert count <= SMALL.exposures


def test_once_a_step_hardly_narrows_none_after_it_pays(scene, solved, monkeypatch) -> None:
    monkeypatch.setattr(proposal, "PAYS", 0.12)
    longer = proposal.composed(scene, replace(SMALL, exposures=8), *solved)
    flags = [step.pays for step in longer.sequence]
    assert flags[0]
    assert not flags[-1]
    assert flags == sorted(flags, reverse=True)
    assert pays(longer) == tuple(step for step in longer.sequence if step.pays)
    assert any("hardly narrow it after" in line for line in plan_lines(longer))


def test_where_nothing_pays_no_radiograph_is_asked_for(plan) -> None:
    steps = tuple(step.model_copy(update={"pays": False}) for step in plan.sequence)
    narrow = plan.model_copy(update={"sequence": steps})
    assert pays(narrow) == ()
    assert any("no further radiograph pays" in line for line in plan_lines(narrow))
    assert any("116 ± 25 N" in line for line in plan_lines(narrow))
    assert not any("best next" in line for line in plan_lines(narrow))
    after = narrow.model_copy(update={"now": {"lateral_bending": 1.8}, "taped": 1.5})
    assert "with a tape around the trunk and no further push: within a factor of 1.5" in " ".join(plan_lines(after))
    assert not any("tape" in line for line in plan_lines(after.model_copy(update={"now": {}, "now_deg": None})))
    sheet = protocol_page(narrow, "anna")
    assert "No further radiograph pays" in sheet
    assert "<table>" not in sheet
    assert "<table>" in protocol_page(plan, "anna")


def test_the_sheet_lists_lateral_radiographs_after_the_frontal_ones_of_the_same_push(plan) -> None:
    first, second = plan.sequence[0], plan.sequence[1]
    aside = first.push.model_copy(update={"view": "frontal+lateral", "side": "left", "level": 6.0, "force_n": 30.0})
    alone = aside.model_copy(update={"view": "frontal", "force_n": 15.0})
    steps = (first.model_copy(update={"push": aside}), second.model_copy(update={"push": alone, "pays": True}))
    sheet = protocol_page(plan.model_copy(update={"sequence": steps}), "anna")
    rows = re.findall(r'<td class="number">([\d.]+)</td><td>(\w+)</td>\n', sheet)
    assert rows == [("0", "frontal"), ("0", "lateral"), ("15", "frontal"), ("30", "frontal"), ("30", "lateral")]
    assert "5 radiographs in 1 push" in sheet
    assert "hold it until both are exposed" in sheet
    one_view = (first.model_copy(update={"push": alone}),)
    assert "hold it until both" not in protocol_page(plan.model_copy(update={"sequence": one_view}), "anna")


def test_a_push_that_does_not_settle_is_left_out(one, monkeypatch) -> None:
    solve = EquilibriumProblem.solve

    def sometimes(self, load, *args, **kwargs):
        if load.label.startswith("30 N from the left"):
            raise EquilibriumError("did not settle")
        return solve(self, load, *args, **kwargs)

    monkeypatch.setattr(EquilibriumProblem, "solve", sometimes)
    found = make_plan(one, replace(FRONTAL, sides=("left", "right")))
    assert {(push.side, push.force_n) for push in found.next} == {("left", 15.0), ("right", 15.0), ("right", 30.0)}


def test_doubts_about_the_estimate_are_told(finished, scene, monkeypatch) -> None:
    opened = open_visit(finished.folder)
    estimate = read_outcome(opened.subject, Estimate)
    tissue = estimate.ratios["tissue"].model_copy(update={"open_low": True})
    odd = estimate.model_copy(update={"ratios": {**estimate.ratios, "tissue": tissue}})
    monkeypatch.setattr(
        "spinestiff.study.planning.scene.read_outcome",
        lambda subject, kind: odd if kind is Estimate else read_outcome(subject, kind),
    )
    found = scene_of(opened)
    assert "tissue" not in found.intervals
    assert any("tissue: the estimate's interval reaches the fit's bounds" in doubt for doubt in found.doubts)


def test_pushes_without_an_estimate_and_dead_loads_are_refused(subject) -> None:
    record = read_json(subject / "results/run.json")
    del record["steps"]["estimate"]
    write_json(subject / "results/run.json", record)
    with pytest.raises(SubjectError, match="there is no estimate from them; run spinestiff run first"):
        scene_of(open_visit(subject))
    content = read_json(subject / "subject.json")
    write_json(subject / "subject.json", {**content, "pelvis": "dead-loads"})
    with pytest.raises(SubjectError, match="pelvis is 'dead-loads'"):
        scene_of(open_visit(subject))


def test_what_is_known_now_is_what_the_estimate_knows_to_first_order(finished, scene) -> None:
    """At the estimate's place; there nuisances are 0 here, and as estimated there."""
    estimate = read_outcome(open_visit(finished.folder).subject, Estimate)
    here = np.log([[estimate.ratios[name].value for name in estimate.parameters]])
    found = make_plan(replace(scene, places=here), FRONTAL)
    sds = np.sqrt(np.diag(np.array(estimate.covariance_log, dtype=float)))
    for name, sd in zip(estimate.parameters, sds):
        assert np.log(found.now[name]) == pytest.approx(1.96 * sd, rel=0.4)
    assert found.estimated.keys() == set(estimate.parameters)


def test_a_push_that_was_planned_and_taken_narrows_as_was_promised(finished, scene) -> None:
    """Half of what the subject's radiographs tell is given; the other half is planned."""
    pushes = scene.taken
    items = [item for item in pushes.trials if item.push == "main"]
    loaded = [item for item in items if item.force_n > 0.0]
    half = replace(pushes, trials=tuple(i for i in items if i.force_n <= loaded[0].force_n))
    less = replace(scene, taken=half, places=scene.places[:1], tracking_factor=1.0)
    site = replace(FRONTAL, sides=(finished_side(finished),), limit_n=loaded[-1].force_n)
    promised = make_plan(less, site)
    both = make_plan(replace(scene, places=scene.places[:1], tracking_factor=1.0), site)
    assert promised.next[0].expected_factor < promised.now["lateral_bending"]
    # A push of its own has errors of site and gauge of its own.
    logs = np.log([promised.next[0].expected_factor, both.now["lateral_bending"]])
    assert logs[0] == pytest.approx(logs[1], rel=0.35)


def finished_side(finished):
    return open_visit(finished.folder).subject.push("main").side


def test_a_cobb_angle_is_a_target(one) -> None:
    found = make_plan(one, replace(SITE, target="cobb", predicted=Frame("right", 8.0, 25.0)))
    degrees = [push.expected_deg for push in found.next]
    assert all(push.expected_factor is None for push in found.next)
    assert degrees == sorted(degrees)
    assert 0.1 < degrees[0] <= found.now_deg < 30.0
    assert now_of(found) == found.now_deg
    assert size_of(found.next[0]) == degrees[0]
    assert "predicted Cobb angle under 25 N from the right at rib 8: now within" in plan_lines(found)[0]


def test_a_tape_narrows_tissue(one, scene, solved) -> None:
    plan = proposal.composed(scene, replace(SMALL, target="tissue"), *solved)
    assert plan.taped < plan.now["tissue"]
    taped = replace(one, known=replace(one.known, taped=True))
    assert make_plan(taped, FRONTAL).taped is None


def test_pushes_that_bend_too_far_are_left_out_and_named(one, solved, monkeypatch) -> None:
    wish = replace(SMALL, sides=("left",), views=("frontal",))
    monkeypatch.setattr(states, "MOST_TURN", np.deg2rad(0.01))
    with pytest.raises(EquilibriumError, match=r"no push of 15 to 30 N .* smaller forces with --limit"):
        make_plan(one, replace(wish, ribs=(8.0,)))
    # Between what half and the whole of the force do.
    turned = turns(one, solved[0])
    monkeypatch.setattr(states, "MOST_TURN", 0.5 * (max(turned[15.0]) + min(turned[30.0])))
    less = make_plan(one, wish)
    assert {push.force_n for push in less.next} == {15.0}
    (note,) = less.notes
    assert note.startswith("30 N from the left at ribs 6, 8: left out; ")


def turns(scene, carried):
    """Largest turns between vertebrae at the first place, rad, by force, of pushes from the left."""
    torso, view = scene.torso, scene.view
    shares = silhouette_shares(torso, view, torso.rest_pose)
    rest = state_features(torso, view, torso.rest_pose, shares).angle
    turned = {}
    for frame, state in zip(carried.frames, carried.states[0][len(carried.known) :], strict=True):
        if frame.side == "left":
            turn = np.ptp(state_features(torso, view, state, shares).angle - rest)
            turned.setdefault(frame.force_n, []).append(turn)
    return turned


def test_before_any_push_a_plan_is_for_the_population(subject) -> None:
    path = subject / "subject.json"
    content = read_json(path)
    content["pushes"] = []
    write_json(path, content)
    marks = read_json(subject / "annotation.json")
    marks["images"] = {name: image for name, image in marks["images"].items() if name.startswith("rest/")}
    aside = marks["images"]["rest/lateral"]["vertebrae"]
    hidden = [name for name in aside if name in marks["images"]["rest/frontal"]["vertebrae"]][-3:]
    for name in hidden:
        del aside[name]
    write_json(subject / "annotation.json", marks)
    visit = open_visit(subject, Settings(mesh="coarse"))
    with pytest.raises(SubjectError, match=r"pushes is empty; spinestiff plan says which push to take first"):
        run_steps(visit)
    (subject / "results/run.json").unlink()
    run_steps(visit, ("personalise",))
    scene = scene_of(visit)
    assert scene.taken is None
    assert np.array_equal(scene.places, population_places())
    assert set(scene.aside) == set(aside)
    assert set(hidden) < set(scene.vertebrae)
    found = make_plan(replace(scene, places=scene.places[:1]), FRONTAL)
    assert (found.basis, found.taken, found.now, found.estimated) == ("population", 0, {}, {})
    assert found.sequence[0].pays
    assert "before any push" in plan_lines(found)[0]


def test_an_estimate_out_of_date_is_refused(subject) -> None:
    content = read_json(subject / "subject.json")
    content["pushes"][0]["forces_n"][1] += 1.0
    write_json(subject / "subject.json", content)
    with pytest.raises(SubjectError, match=r"were made before .* changed; run spinestiff \w+ again"):
        scene_of(open_visit(subject))


def test_places_follow_a_curved_valley() -> None:
    x = np.random.default_rng(0).permutation(np.linspace(-2.0, 2.0, 600))
    draws = np.stack([x, 0.5 * x**2], axis=1)
    places = places_of_draws(draws, 5)
    order = np.argsort(places[:, 0])
    assert np.allclose(places[order, 0], [-1.6, -0.8, 0.0, 0.8, 1.6], atol=0.1)
    # A mean of all would lie off it.
    assert np.allclose(places[order, 1], 0.5 * places[order, 0] ** 2, atol=0.1)
    assert len(places_of_draws(draws[:3], 5)) == 3


def test_draws_are_read_by_name(tmp_path) -> None:
    path = tmp_path / DRAWS_FILE
    path.write_text("lateral_bending,tissue,gauge\n0.1,0.02,0.5\n0.2,0.04,-1\n", encoding="utf-8")
    np.testing.assert_array_equal(read_draws(path, ("tissue", "lateral_bending")), [[0.02, 0.1], [0.04, 0.2]])
    with pytest.raises(SubjectError, match=re.escape(f"{path}: no draws of tissue, other")):
        read_draws(path, ("tissue", "other"))


def test_impossible_wishes_are_refused(scene) -> None:
    with pytest.raises(SubjectError, match="give --under SIDE,RIB,FORCE"):
        Wish(target="cobb")
    with pytest.raises(SubjectError, match="goes with --target cobb"):
        Wish(predicted=Frame("left", 8.0, 30.0))
    for limit in (1.0, float("nan"), float("inf")):
        with pytest.raises(SubjectError, match="wanted 5 N or more"):
            Wish(limit_n=limit)
    with pytest.raises(SubjectError, match="no side or no rib"):
        Wish(ribs=())
    with pytest.raises(SubjectError, match=r"no view to take; give one of frontal, frontal\+lateral, or both"):
        Wish(views=())
    with pytest.raises(SubjectError, match="exposures for 1 frontal radiographs; a push seen as frontal takes 2"):
        Wish(exposures=1)
    assert max(frame.force_n for frame in Wish(limit_n=77.77).frames) == 77.7
    with pytest.raises(SubjectError, match="the estimate has no ratio tissue"):
        make_plan(replace(scene, names=("lateral_bending",)), Wish(target="tissue"))


def test_what_cameras_saw_is_no_radiograph_that_was_taken(scene) -> None:
    """It tells of the ratios, and is not counted."""

    def widths_of(pushes):
        known = [(pushes.problems[item.push], item.trial) for item in pushes.fitted]
        carried = SimpleNamespace(
            groups=parameter_groups(scene.torso, scene.names),
            known=[one for one in known if one[1].load.size],
            known_still=[one for one in known if not one[1].load.size],
            planned={},
            still=[],
            predicted=None,
            frames=[],
            pushes=[],
            places=[],
            states=[],
        )
        return widths.ExpectedWidths(replace(scene, taken=pushes), carried)

    points, outward = spread_markers(scene.torso, 8, np.full((1, 3), 1e4))
    names, there = tuple(f"m{i}" for i in range(8)), points.positions(scene.torso, scene.torso.rest_pose)
    marked = tuple(
        replace(
            item, trial=replace(item.trial, markers=SkinMarkers(names, there, points, outward, f"{item.push} markers"))
        )
        for item in scene.taken.trials
    )
    radiographs = len(scene.taken.fitted)
    found = widths_of(replace(scene.taken, trials=marked))
    assert (len(found.taken), found.taken_radiographs) == (2 * radiographs, radiographs)
    assert widths_of(scene.taken).taken_radiographs == radiographs
