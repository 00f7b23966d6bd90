"""Synthetic subjects: a folder like any other, with a truth that never leaks into it."""

from __future__ import annotations

import errno
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.stiffness import RATIO_BOUNDS
from spinestiff.anatomy.template import MESHES, template_torso
from spinestiff.errors import EquilibriumError, OutsideWarning, SpinestiffError, SubjectError, TorsoError, TrackingError
from spinestiff.files import file_digest
from spinestiff.imaging.pedicles import pedicle_centres
from spinestiff.imaging.synthetic.collimation import Collimation
from spinestiff.imaging.tracking.quality import usable_corners
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.personalise.markers import place_markers
from spinestiff.personalise.pose import align_view
from spinestiff.study.side_views import followed_view, marked_pedicles, side_views
from spinestiff.study.synthetic import subject as synthetic
from spinestiff.study.synthetic.elastic_supports import SupportStiffness, SyntheticSupports
from spinestiff.study.synthetic.markers import spread_markers
from spinestiff.study.synthetic.recipe import Recipe, SyntheticPush
from spinestiff.study.synthetic.stiffening import Stiffening
from spinestiff.study.synthetic.subject import (
    BENDING_RANGE,
    TISSUE_RANGE,
    made_by,
    subject_torso,
    synthesise,
    truth_path,
)
from spinestiff.study.synthetic.visit import ANNOTATION_SD_MM, misread
from spinestiff.subject.annotated_points import image_corners, image_supports
from spinestiff.subject.annotation_record import ImageAnnotation
from spinestiff.subject.folder import read_push, read_rest, read_subject, read_view
from spinestiff.subject.marker_table import read_markers

PUSH = SyntheticPush("main", 8.0, (0.0, 1.0), ("unused", "training"))
LEVEL = SyntheticSupports(obliquity_deg=0.0, shoulder_mm=0.0)


def digests(folder: Path) -> dict[str, str]:
    return {p.relative_to(folder).as_posix(): file_digest(p) for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture(scope="module")
def tiny(cheap_recipe):
    return replace(cheap_recipe, shape=(128, 128), force_n=10.0, ratios=None, pushes=(PUSH,))


@pytest.fixture(scope="module")
def shaped(tiny):
    """The torso of ``tiny``, whose shape is that of every recipe that differs from it in other things alone."""
    return subject_torso(tiny)


@pytest.fixture
def held(tiny, shaped, monkeypatch):
    """``tiny`` for tests of other things than shape and supports: its torso is there, and its supports don't give."""
    monkeypatch.setattr(synthetic, "subject_torso", lambda recipe, say: shaped)
    return replace(tiny, supports=LEVEL)


@pytest.fixture(scope="module")
def twins(tmp_path_factory, tiny):
    folders = []
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        folders.append(tmp_path_factory.mktemp("twins") / name)
        synthesise(folders[-1], replace(tiny, seed=seed))
    return folders


def test_the_folder_is_a_subject(finished):
    subject = read_subject(finished.folder)
    assert subject.warnings == ()
    assert subject.record.height_cm == 157.0
    assert [push.id for push in subject.pushes] == ["main", "second"]
    main, second = subject.pushes
    assert main.side == second.side == "left"  # the curve is left-convex and is pushed straight
    assert main.forces_n == (0.0, 15.0, 22.5, 30.0)
    assert main.frames_of("training") == (1, 2)
    assert second.frames_of("training") == ()
    assert 100.0 < main.d31_mm < main.d21_mm < 500.0
    assert second.d31_mm < main.d31_mm  # rib 6 lies higher than rib 8
    for push in subject.pushes:
        frames = read_push(subject, push)
        corners = image_corners(subject, push.image, frames[0].view)
        assert len(corners) >= 12
        supports = image_supports(subject, push.image)
        assert supports and set(supports) <= {"pelvis", "shoulder"}
        assert frames[1].time_s == pytest.approx(0.25)
    assert read_rest(subject, "lateral").view.shape == (512, 512)


def test_radiographs_show_the_torso(finished):
    """The spine absorbs more than what is beside it, and pushing changes the picture."""
    subject = read_subject(finished.folder)
    picture = read_rest(subject, "frontal")
    pixels = np.asarray(picture.pixels, dtype=float)
    corners = image_corners(subject, "rest/frontal", picture.view)
    column, row = picture.view.pixels(corners.corners[corners.vertebrae.index("L1")]).mean(0).astype(int)
    patch = pixels[row - 5 : row + 5, column - 5 : column + 5].mean()
    assert patch > pixels[row - 5 : row + 5, :8].mean() + 0.2 * np.ptp(pixels)
    first, *_, last = (np.asarray(frame.pixels, dtype=float) for frame in read_push(subject, subject.push("main")))
    assert np.abs(last / last.mean() - first / first.mean()).mean() > 0.01


def test_the_truth_lies_beside_the_folder_and_not_inside(finished, cheap_recipe):
    assert finished.truth == finished.folder.with_name("girl.truth.json") == truth_path(finished.folder)
    truth = json.loads(finished.truth.read_text())
    assert truth["ratios"] == {"lateral_bending": 0.2, "tissue": 0.05}
    assert truth["recipe"] == cheap_recipe.as_record()
    assert truth["vertebrae"] == list(VERTEBRAE)
    assert truth["rest_cobb_deg"] == pytest.approx(12.0, abs=2.0)
    assert [len(truth["pushes"][push]) for push in ("main", "second")] == [4, 2]
    changes = [frame["cobb_change_deg"]["tilt"] for frame in truth["pushes"]["main"]]
    assert changes[0] == pytest.approx(0.0, abs=0.1)  # an unloaded torso is at rest
    assert changes[-1] < changes[1] < 0.0  # a push from the left makes a spine right-convex
    words = [b"truth", b"ratios"]
    for path in finished.folder.rglob("*"):
        if path.is_file() and "results" not in path.parts:
            assert not any(word in path.read_bytes() for word in words), path


def test_the_truth_holds_what_the_supports_gave_in_each_frame(finished):
    truth = json.loads(finished.truth.read_text())
    asked, pushes = truth["supports"], truth["pushes"]
    assert 0.0 < asked["obliquity_deg"] < 4.0
    assert 0.0 < asked["shoulder_mm"] < 4.0
    for key, sign in (("obliquity_deg", 1.0), ("shoulder_mm", -1.0)):  # the push comes from the left
        main, second = ([sign * frame[key] for frame in pushes[push]] for push in ("main", "second"))
        assert main[0] == second[0] == pytest.approx(0.0, abs=1e-3)
        assert 0.0 < main[1] < main[2] < main[3]
        assert max(main[3], second[1]) == pytest.approx(asked[key], rel=0.02)
    assert max(frame["shoulder_mm"] for frame in pushes["main"]) < 1e-3


def test_given_supports_change_the_pushes_and_nothing_else(twins, tiny, tmp_path):
    """What is drawn for the supports has a random stream of its own."""
    synthesise(tmp_path / "level", replace(tiny, seed=5, supports=LEVEL))
    truth = json.loads(truth_path(tmp_path / "level").read_text())
    assert truth["recipe"]["supports"] == {"obliquity_deg": 0.0, "shoulder_mm": 0.0}
    assert truth["supports"]["belt_n_mm_per_rad"] is None
    last = truth["pushes"]["main"][-1]
    assert last["obliquity_deg"] == pytest.approx(0.0, abs=1e-4)
    assert abs(last["shoulder_mm"]) < 0.02
    before, after = digests(twins[0]), digests(tmp_path / "level")
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {"pushes/main.dcm"}


def test_a_push_from_the_other_side_is_told_and_done_from_there(tmp_path, held):
    pushes = (PUSH, replace(PUSH, id="against", other_side=True))
    recipe = replace(held, pushes=pushes, side="left", age=11.0, sex="male")
    truth = json.loads(synthesise(tmp_path / "a", recipe).read_text())
    subject = read_subject(tmp_path / "a")
    assert (subject.record.age, subject.record.sex) == (11.0, "male")
    assert [push.side for push in subject.pushes] == ["left", "right"]
    ways = []
    for push in pushes:
        first, last = (np.array(frame["corners_px"]) for frame in truth["pushes"][push.id])
        ways.append(float(np.mean(last - first, axis=(0, 1))[0]))
    assert ways[0] * ways[1] < 0.0 and min(map(abs, ways)) > 0.2
    # The shoulder that holds against a push is marked in its picture: the other one each.
    marked = [image_supports(subject, push.image)["shoulder"][0, 0] for push in subject.pushes]
    assert abs(marked[0] - marked[1]) > 40.0
    with pytest.raises(SubjectError, match="all pushes are from the other side"):
        replace(held, pushes=pushes[1:])


def test_a_gauge_misreads_what_is_told_and_nothing_else(tmp_path, held):
    recipe = replace(held, force_n=40.0)
    for name, wrongly in (("right", False), ("wrong", True)):
        synthesise(tmp_path / name, replace(recipe, misread=wrongly))
    right, wrong = (digests(tmp_path / name) for name in ("right", "wrong"))
    assert {name for name in right if right[name] != wrong[name]} == {"subject.json"}
    told = read_subject(tmp_path / "wrong").push("main")
    assert told.forces_n[0] == 0.0
    assert told.forces_n[1] != 40.0 and abs(told.forces_n[1] - 40.0) < 12.0


def test_misread_forces_have_the_errors_of_the_priors():
    random = np.random.default_rng(0)
    told = [misread((0.0, 100.0, 20.0), 6.0, random) for _ in range(2000)]
    forces, levels = np.array([one[0] for one in told]), np.array([one[1] for one in told])
    assert (forces[:, 0] == 0.0).all()
    assert forces[:, 1].std() == pytest.approx(np.hypot(2.0, 1.5), rel=0.1)
    assert forces[:, 2].std() == pytest.approx(np.hypot(0.4, 1.5), rel=0.1)
    assert levels.std() == pytest.approx(0.2, rel=0.1)
    assert misread((0.1,), 1.0, random)[0][0] > 0.0


def test_stiffening_discs_turn_less_and_less_with_force_and_are_in_the_truth(held, tmp_path):
    push = replace(PUSH, shares=(0.0, 0.4, 1.0), roles=("unused", "training", "training"))
    plain = replace(held, pushes=(push,), force_n=40.0, ratios=(0.3, 0.02))
    law, bent, truths = Stiffening(0.2, 0.5), {}, {}
    for name, recipe in (("linear", plain), ("stiffening", replace(plain, stiffening=law))):
        truths[name] = json.loads(synthesise(tmp_path / name, recipe).read_text())
        bent[name] = [abs(frame["cobb_change_deg"]["tilt"]) for frame in truths[name]["pushes"]["main"]]
    assert truths["stiffening"]["recipe"]["stiffening"] == {"low": 0.2, "theta_deg": 0.5}
    assert truths["stiffening"]["ratios"] == truths["linear"]["ratios"]
    discs = truths["stiffening"]["disc_bending"]
    assert 0.3 < discs["energy"] < discs["moment"] < 2.0 * discs["energy"]
    assert "disc_bending" not in truths["linear"]
    # The tissue, which stays as it is, hides a part of it.
    later, sooner = bent["stiffening"][2] / bent["stiffening"][1], bent["linear"][2] / bent["linear"][1]
    assert later < 0.8 * sooner
    assert later > 1.2


def test_stiffening_discs_have_their_ratio_under_the_largest_force_of_the_first_push_from_the_main_side(
    tmp_path, tiny, monkeypatch
):
    class FoundError(Exception):
        pass

    def found(problem, law, torso, load, wanted):
        raise FoundError(load)

    monkeypatch.setattr(synthetic, "subject_torso", lambda recipe, say: template_torso(recipe.height_cm, "coarse"))
    monkeypatch.setattr(synthetic, "support_stiffness", lambda *given: SupportStiffness(None, 100.0))
    monkeypatch.setattr(synthetic, "solved_with", found)
    pushes = replace(PUSH, id="other", other_side=True), replace(PUSH, shares=(0.0, 0.5))
    with pytest.raises(FoundError) as caught:
        synthesise(tmp_path / "x", replace(tiny, pushes=pushes, stiffening=Stiffening(0.5, 3.0), side="left"))
    (load,) = caught.value.args
    np.testing.assert_allclose(load.push.total, [-5.0, 0.0, 0.0], atol=1e-12)


def test_the_annotation_is_the_truth_with_a_persons_error(finished):
    subject = read_subject(finished.folder)
    truth = json.loads(finished.truth.read_text())
    view = read_push(subject, subject.push("main"))[0].view
    clicked = image_corners(subject, "push/main", view)
    true = np.array(truth["pushes"]["main"][0]["corners_px"])[[VERTEBRAE.index(v) for v in clicked.vertebrae]]
    error = view.to_patient_plane(clicked.corners) - view.to_patient_plane(view.from_pixels(true))
    assert error.std() == pytest.approx(ANNOTATION_SD_MM, rel=0.3)
    assert abs(error.mean()) < 0.1


def test_a_biplanar_subject_has_lateral_radiographs_and_pedicles_of_every_frame(tmp_path, held, shaped):
    push = SyntheticPush("main", 8.0, (0.0, 0.5, 1.0), ("unused", "training", "training"))
    truth = synthesise(tmp_path / "both", replace(held, biplanar=True, pushes=(push,), shape=(256, 256)))
    subject = read_subject(tmp_path / "both")
    (record,) = subject.pushes
    (view,) = record.views
    assert (view.id, view.kind, view.frames) == ("lateral", "lateral", (0, 1, 2))
    assert json.loads(truth.read_text())["recipe"]["biplanar"] is True
    frontal = read_push(subject, record)[0].view
    torso = shaped
    (side,) = side_views(subject, record)
    marks = marked_pedicles(subject, record, frontal)
    assert [one.frame for one in marks] == [one.frame for one in side.pictures] == [0, 1, 2]
    wide = {name: 2.0 * offset for name, offset in zip(torso.vertebrae, pedicle_centres(torso)[:, 0, 0])}
    frames = [frontal.to_patient_plane(one.points(frontal).points) for one in marks]
    apart = np.array([points[:, 0, 0] - points[:, 1, 0] for points in frames])
    # All of a person's lie farther out or in, by 2 mm a side; marks err by 0.7 mm each.
    assert np.abs(apart - [wide[name] for name in marks[0].vertebrae]).mean() < 10.0
    assert 0.3 < np.std(apart, axis=0).mean() < 1.5
    _, pose = align_view(torso, torso.rest_pose, side.view.view(), side.corners(side.pictures[0]))
    assert pose.rms_mm < 0.6
    turned = record.model_copy(update={"views": (view.model_copy(update={"turned_deg": 30.0}),)})
    (oblique,) = side_views(subject, turned)
    # The source stands at the right of a patient, who turns the back to it by turning to the left.
    beams = [one.view.view().normal for one in (side, oblique)]
    assert np.degrees(np.arccos(beams[0] @ beams[1])) == pytest.approx(30.0)
    assert oblique.view.view().source[2] - side.view.view().source[2] == pytest.approx(-670.0, abs=1.0)


def test_what_nobody_marked_in_a_view_is_followed_and_marks_by_hand_win(tmp_path, held):
    push = SyntheticPush("main", 8.0, (0.0, 0.3, 0.6, 1.0), ("unused", "unused", "training", "training"))
    synthesise(tmp_path / "both", replace(held, biplanar=True, pushes=(push,), shape=(512, 512)))
    whole = read_subject(tmp_path / "both")
    (record,) = whole.pushes
    fewer = whole.annotation.images["push/main/2/lateral"].model_dump()
    del fewer["vertebrae"]["T8"]
    images = {**whole.annotation.images, "push/main/2/lateral": ImageAnnotation.model_validate(fewer)}
    whole = replace(whole, annotation=whole.annotation.model_copy(update={"images": images}))
    (every,) = side_views(whole, record)
    kept = {
        name: image
        for name, image in whole.annotation.images.items()
        if name not in ("push/main/1/lateral", "push/main/3/lateral")
    }
    (some,) = side_views(replace(whole, annotation=whole.annotation.model_copy(update={"images": kept})), record)
    assert [one.followed_from for one in every.pictures] == [None] * 4
    assert [one.followed_from for one in some.pictures] == [None, 0, None, 2]
    assert some.pictures[0] == every.pictures[0] and some.pictures[2] == every.pictures[2]
    assert [("T8" in one.vertebrae) for one in some.pictures] == [True, True, False, True]
    for number in (1, 3):
        found, marked = some.corners(some.pictures[number]), every.corners(every.pictures[number])
        names = [name for name in usable_corners(found).vertebrae if name in marked.vertebrae]
        assert len(names) > 5
        apart = found.selected(names).corners - marked.selected(names).corners
        # Each mark errs by 0.3 mm; tracking adds as much and more.
        assert np.median(np.abs(apart)) / every.view.view().magnification < 0.8
    blank = [replace(frame, pixels=np.ones_like(frame.pixels)) for frame in read_view(whole, record, record.views[0])]
    with pytest.raises(TrackingError, match=r"^push 'x' view 'y': .*; or mark the corners in each of its radiographs$"):
        followed_view(blank, {0: every.corners(every.pictures[0])}, "push 'x' view 'y'")


def test_a_subject_with_markers_has_a_table_of_them_that_meets_its_skin(tmp_path, held, shaped):
    recipe = replace(held, pushes=(PUSH, replace(PUSH, id="other")), shape=(256, 256))
    for name, count in (("bare", 0), ("marked", 12)):
        truth = synthesise(tmp_path / name, replace(recipe, markers=count))
    assert json.loads(truth.read_text())["recipe"]["markers"] == 12
    bare, marked = (digests(tmp_path / name) for name in ("bare", "marked"))
    tables = {"pushes/main-markers.csv", "pushes/other-markers.csv"}
    assert {name for name in marked if bare.get(name) != marked[name]} == {"subject.json"} | tables
    subject = read_subject(tmp_path / "marked")
    record = subject.push("main")
    view = read_push(subject, record)[0].view
    tracks = read_markers(subject, record, view)
    torso = shaped
    clicked = image_corners(subject, "push/main", view)
    standing, _ = align_view(torso, torso.rest_pose, view, clicked)
    rows, pixels = tracks.shown
    shown = rows, view.from_pixels(pixels)
    placed = place_markers(torso, tracks.names, tracks.positions[0], shown, standing, tracks.side, np.deg2rad(3.0))
    # A breath and errors of the cameras away from this very skin.
    assert np.abs(placed.off_mm).max() < 6.0
    places = placed.placed(tracks.positions)
    moved = places[1] - places[0]
    # A push of 10 N from the right moves the trunk to the left, or the other way.
    assert np.sign(np.median(moved[:, 0])) == record.sign
    assert 1.0 < np.abs(moved[:, 0]).max() < 60.0
    # Off the gauge's pad.
    load = rib_push(torso, record.side, 8.0, 1.0).points.positions(torso.rest_pose)
    assert cKDTree(load).query(places[0])[0].min() > 50.0


def test_markers_that_are_too_few_or_find_no_room_are_refused(tiny, shaped):
    with pytest.raises(SubjectError, match="2 markers; wanted 0, or 3 to 60"):
        replace(tiny, markers=2)
    with pytest.raises(SubjectError, match="this torso's front and flanks have room for"):
        spread_markers(shaped, 100_000, np.zeros((1, 3)))


def test_the_same_seed_gives_the_same_bytes(twins):
    first, second, other = twins
    assert digests(first) == digests(second)
    assert file_digest(truth_path(first)) == file_digest(truth_path(second))
    assert len(digests(first)) == 5
    for name, digest in digests(other).items():
        assert digests(first)[name] != digest, name


def test_ratios_that_are_not_given_are_drawn_from_the_papers_range(twins):
    drawn = [json.loads(truth_path(folder).read_text())["ratios"] for folder in twins]
    assert drawn[0] == drawn[1] != drawn[2]
    for ratios in drawn:
        assert BENDING_RANGE[0] <= ratios["lateral_bending"] <= BENDING_RANGE[1]
        assert TISSUE_RANGE[0] <= ratios["tissue"] <= TISSUE_RANGE[1]


def test_a_fit_may_look_three_times_beyond_the_ratios_that_subjects_have():
    for low, high in (BENDING_RANGE, TISSUE_RANGE):
        assert RATIO_BOUNDS[0] <= low / 3.0 and 3.0 * high <= RATIO_BOUNDS[1]


def test_a_folder_in_use_is_refused_untouched(twins, tiny):
    before = digests(twins[0])
    with pytest.raises(SubjectError, match="is not empty; choose another folder, nothing was written"):
        synthesise(twins[0], tiny)
    assert digests(twins[0]) == before


def test_a_body_that_the_template_does_not_have_is_refused_before_any_work(tiny, tmp_path):
    """Its own mesh has it, those of an estimate do not."""
    wanted = "the template has no body of 8 years, male, 198 cm: the tissue mesh does not fit this body"
    with pytest.raises(TorsoError, match=wanted):
        synthesise(tmp_path / "new", replace(tiny, age=8.0, sex="male", height_cm=198.0))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("closed", ["new", ""])
def test_a_place_that_can_not_be_written_is_refused_before_any_work(tiny, tmp_path, monkeypatch, closed):
    """The folder itself, and that in which the truth goes."""
    touch = Path.touch

    def refuse(self, *args, **kwargs):
        if self.parent == tmp_path / closed:
            raise OSError(errno.EROFS, "x", str(self))
        touch(self, *args, **kwargs)

    monkeypatch.setattr(Path, "touch", refuse)
    monkeypatch.setattr(synthetic, "subject_torso", lambda *args: pytest.fail("shaped"))
    place = re.escape(str(tmp_path / closed))
    with pytest.raises(SubjectError, match=rf"^{place}: can't be written \(the file system is read-only\)"):
        synthesise(tmp_path / "new", tiny)


def test_made_by_tells_the_same_recipe_from_another(twins, tiny, tmp_path):
    recipe = replace(tiny, seed=5)
    assert made_by(twins[0], recipe)
    with pytest.raises(SubjectError, match="holds another subject"):
        made_by(twins[0], replace(recipe, force_n=11.0))
    assert not made_by(tmp_path / "new", recipe)
    assert not made_by(tmp_path, recipe)
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(SubjectError, match="holds another subject"):
        made_by(tmp_path, recipe)


def test_a_push_that_cannot_be_carried_leaves_nothing_behind(tmp_path, held, monkeypatch):
    def limited(solve):
        """Gives up early what would take minutes."""
        return lambda self, load, *args, **kwargs: solve(
            self, load, *args, **kwargs, **({"most_factorisations": 2} if load.size > 100.0 else {})
        )

    for name in ("solve", "solve_linearised"):
        monkeypatch.setattr(EquilibriumProblem, name, limited(getattr(EquilibriumProblem, name)))
    with pytest.warns(OutsideWarning, match="490 N"), pytest.raises(EquilibriumError, match="reduce the force"):
        synthesise(tmp_path / "crushed", replace(held, force_n=490.0, ratios=(0.05, 0.01), supports=None))
    assert list(tmp_path.iterdir()) == []


def test_the_truth_of_the_folder_one_stands_in_has_a_name(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert truth_path(".") == truth_path(tmp_path / "here") == tmp_path / "here.truth.json"
    assert truth_path("sub") == Path("sub.truth.json")


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"ratios": (0.001, 0.1)}, "stiffness ratio 0.001; wanted 0.0025 to 5.0"),
        ({"ratios": (0.1, 6.0)}, "stiffness ratio 6.0"),
        ({"ratios": (float("nan"), 0.1)}, "stiffness ratio nan"),
        ({"force_n": 0.0}, "force 0.0 N"),
        ({"force_n": 501.0}, "force 501.0 N"),
        ({"force_n": float("nan")}, "force nan N"),
        ({"seed": -1}, "seed -1; wanted 0 or more"),
        ({"nodes": 2999}, "2999 nodes; wanted 3000 to 65000"),
        ({"nodes": 5000, "mesh": "fine"}, "nodes 5000 of mesh 'fine'; wanted mesh 'own', or no nodes"),
        ({"pushes": ()}, "pushes none; wanted at least one"),
        ({"pushes": (PUSH, PUSH)}, "pushes main, main; wanted at least one, each with an id of its own"),
    ],
)
def test_impossible_recipes_are_refused(wrong, words):
    with pytest.raises(SubjectError, match=words):
        Recipe(**wrong)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"shares": ()}, r"push 'main': shares \(\); wanted 0 first, then 0 to 1"),
        ({"shares": (0.1, 1.0)}, "wanted 0 first"),
        ({"shares": (0.0, 1.1)}, "wanted 0 first, then 0 to 1"),
        ({"shares": (0.0, float("nan"))}, "wanted 0 first, then 0 to 1"),
        ({"shares": (0.0, 0.5, 1.0)}, "push 'main': 3 shares and 2 roles; wanted one of each a frame"),
    ],
)
def test_impossible_pushes_are_refused(wrong, words):
    with pytest.raises(SubjectError, match=words):
        replace(PUSH, **wrong)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"id": "a/b"}, "push 'a/b' of the recipe: id: found 'a/b'"),
        ({"level": 0.5}, "push level 0.5; wanted a rib number from 1 to 12"),
        ({"level": 1.0}, "push 'main' of the recipe: d31_mm"),
    ],
)
def test_a_push_that_no_subject_may_have_leaves_nothing_behind(tmp_path, held, wrong, words):
    with pytest.raises(SpinestiffError, match=words):
        synthesise(tmp_path / "x", replace(held, pushes=(replace(PUSH, **wrong),)))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"pushes": (replace(PUSH, roles=("unused", "validation")),)}, "the recipe: pushes: no frame has the role"),
        ({"age": 0.0}, "the recipe: age: found 0.0, wanted greater than 0"),
        ({"sex": "girl"}, "the recipe: sex: found 'girl'"),
    ],
)
def test_a_recipe_that_no_subject_may_have_is_refused_before_anything_is_solved(
    tmp_path, tiny, monkeypatch, wrong, words
):
    monkeypatch.setattr(synthetic, "subject_torso", lambda recipe, say: template_torso(recipe.height_cm, "coarse"))
    monkeypatch.setattr(synthetic, "support_stiffness", lambda *given: pytest.fail("was solved"))
    with pytest.raises(SubjectError, match=words):
        synthesise(tmp_path / "x", replace(tiny, **wrong))
    assert list(tmp_path.iterdir()) == []


def test_radiographs_that_show_too_little_of_the_spine_are_refused_before_the_first_file(tmp_path, tiny, monkeypatch):
    monkeypatch.setattr(synthetic, "subject_torso", lambda recipe, say: template_torso(recipe.height_cm, "coarse"))
    monkeypatch.setattr(synthetic, "support_stiffness", lambda *given: SupportStiffness(None, 100.0))
    monkeypatch.setattr(synthetic, "in_parallel", lambda solve, pushes: [[] for _ in pushes])
    narrow = replace(tiny.acquisition, collimation=Collimation(top=250.0))
    with pytest.raises(SubjectError, match="a frontal radiograph shows 4 vertebrae as a whole, wanted at least 8"):
        synthesise(tmp_path / "x", replace(tiny, acquisition=narrow))
    assert list(tmp_path.iterdir()) == []


def test_the_default_mesh_is_none_of_the_estimators():
    """It shares no point with those, has more of them and as much tissue."""
    recipe = Recipe()
    assert recipe.mesh not in MESHES
    own = template_torso(recipe.height_cm, recipe.mesh).tissue
    for mesh in MESHES:
        other = template_torso(recipe.height_cm, mesh).tissue
        assert len(own.rest_positions) > 1.2 * len(other.rest_positions)
        assert cKDTree(other.rest_positions).query(own.rest_positions)[0].min() > 1e-3
        assert own.corner_volumes().sum() == pytest.approx(other.corner_volumes().sum(), rel=3e-3)


def test_a_mesh_of_a_subjects_own_is_asked_for_by_seed_and_nodes(monkeypatch):
    """Up to 6,000 nodes the skin is the coarse template's, above the finer one's."""
    asked = []
    monkeypatch.setattr(synthetic, "place_vertebrae", lambda torso, *poses, **how: asked.append((torso, how)))
    for recipe in (Recipe(seed=7, nodes=3000), Recipe(seed=8, nodes=25_000), Recipe(seed=9)):
        synthetic.subject_torso(recipe)
    counts = [len(torso.tissue.rest_positions) for torso, _ in asked]
    assert counts == [len(template_torso(157.0, mesh).tissue.rest_positions) for mesh in ("coarse", "own", "own")]
    assert [(how["seed"], how["nodes"]) for _, how in asked] == [(7, 3000), (8, 25_000), (9, None)]


@pytest.mark.parametrize("mesh", ["own", "coarse"])
def test_the_body_is_of_the_recipes_age_and_sex(monkeypatch, mesh):
    monkeypatch.setattr(synthetic, "place_vertebrae", lambda torso, *poses, **how: torso)
    boy, reference = (
        synthetic.subject_torso(replace(Recipe(height_cm=175.0, mesh=mesh), **who))
        for who in ({"age": 16.0, "sex": "male"}, {})
    )
    wanted = template_torso(175.0, mesh, age_years=16.0, sex="male").tissue.rest_positions
    np.testing.assert_array_equal(boy.tissue.rest_positions, wanted)
    widths = [np.ptp(torso.tissue.rest_positions[:, 0]) for torso in (boy, reference)]
    assert abs(widths[0] - widths[1]) > 5.0


def test_a_recipes_record_names_the_table_without_its_place():
    record = Recipe(spine=(Path("somewhere") / "spines.csv", "a1"), ratios=(0.1, 0.01)).as_record()
    assert record["spine"] == ["spines.csv", "a1"]
    assert record["ratios"] == [0.1, 0.01]
    assert [push["id"] for push in record["pushes"]] == ["main", "second"]
    assert json.loads(json.dumps(record)) == record
