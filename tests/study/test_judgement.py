"""Sound results pass every check; each mix-up is found by the check that is there for it, with its cause in words."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import TrackingError
from spinestiff.estimation.objective import make_target, residuals
from spinestiff.imaging.dicom.identity import Identity
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.personalise.shape import personalise
from spinestiff.study.fits import fit_pushes
from spinestiff.study.judgement import failed, judge, outlying_notes
from spinestiff.study.judgement.limits import LIMITS
from spinestiff.study.judgement.rest_shape import RestShape
from spinestiff.study.synthetic.spines import curved_spine
from spinestiff.study.trials import push_set
from spinestiff.subject.outcomes import TrackedPush
from spinestiff.subject.records import PushRecord, SubjectRecord

HEIGHT = 157.0
RATIOS = {"lateral_bending": 0.1, "tissue": 0.02}
FORCES = (0.0, 20.0, 40.0, 60.0)
ROLES = ("unused", "training", "training", "validation")
PULLS = (30.0, 1000.0)
MIRRORED = [1, 0, 3, 2]
PERSON = Identity(("number", "name and birth"), 735000, False)


@dataclass(frozen=True)
class Case:
    """What the steps know of a subject; a mix-up replaces a part of it."""

    record: SubjectRecord
    rest: dict
    tracked: TrackedPush
    shaped: object
    fit: object
    identities: dict

    @property
    def pushes(self):
        return push_set(self.shaped.torso, self.record.pushes, {"main": self.tracked})

    def checks(self):
        return judge(self.record, RestShape.of(self.shaped), self.pushes, self.fit, self.identities)

    def doubts(self):
        return {check.name: check.text for check in failed(self.checks())}

    def check(self, name):
        (found,) = (check for check in self.checks() if check.name == name)
        return found

    def with_push(self, **changes):
        push = PushRecord.model_validate({**self.record.pushes[0].model_dump(), **changes})
        return replace(self, record=self.record.model_copy(update={"pushes": (push,)}))

    def with_frames(self, change):
        """The corners of every frame changed."""
        corners = [change(self.tracked.corners(i)) for i in range(len(FORCES))]
        return replace(self, tracked=TrackedPush.of(self.tracked.view.view(), corners))

    def with_rest(self, height_cm=HEIGHT, **pictures):
        """Personalised anew, with other pictures or from the template of another height."""
        rest = {**self.rest, **pictures}
        return replace(self, rest=rest, shaped=personalise(template(height_cm), rest))


def template(height_cm=HEIGHT):
    return template_torso(height_cm, "coarse")


def view_of(make):
    spine = template().rest_pose.bone_positions[template().vertebra_bones]
    return make(shape=(1536, 1024), centre=[0.0, 0.5 * (spine[0, 1] + spine[-1, 1]), 0.0])


def seen(torso, view, state, noise):
    shares = silhouette_shares(torso, view, torso.rest_pose)
    return VertebraCorners(VERTEBRAE, state_features(torso, view, state, shares).corners + noise * view.magnification)


def truth_of(cobb_deg, curve):
    return place_vertebrae(template(), *curved_spine(template(), cobb_deg, curve), PULLS)


def pictures_of(torso, random):
    views = {"frontal": view_of(frontal_view), "lateral": view_of(lateral_view)}
    noise = {name: random.normal(0.0, 0.3, (17, 4, 2)) for name in views}
    return {name: (seen(torso, view, torso.rest_pose, noise[name]), view) for name, view in views.items()}


@pytest.fixture(scope="module")
def sound():
    """A subject by corners: annotated to 0.3 mm, tracked to 0.1 mm."""
    random = np.random.default_rng(1)
    torso = truth_of(20.0, "thoracic")
    rest = pictures_of(torso, random)
    problem, view = EquilibriumProblem(torso, three_point_supports(torso, "left")), rest["frontal"][1]
    annotated, frames, state = random.normal(0.0, 0.3, (17, 4, 2)), [], torso.rest_pose
    for force in FORCES:
        state = problem.solve(rib_push(torso, "left", 8.0, force), stiffness_ratios(RATIOS), state).require().state
        tracking = random.normal(0.0, 0.1 if force else 0.0, (17, 4, 2))
        frames.append(seen(torso, view, state, annotated + tracking))
    push = PushRecord(
        id="main", side="left", level=8.0, d21_mm=400.0, d31_mm=200.0, frames="main", forces_n=FORCES, roles=ROLES
    )
    record = SubjectRecord(schema_version=1, id="girl", age=13.0, sex="female", height_cm=HEIGHT, pushes=(push,))
    tracked = TrackedPush.of(view, frames)
    shaped = personalise(template(), rest)
    pushes = push_set(shaped.torso, record.pushes, {"main": tracked})
    fit = fit_pushes(pushes, ("lateral_bending", "tissue"), RATIOS, extent="estimate")
    images = ("rest/frontal", "rest/lateral", "push/main")
    return Case(record, rest, tracked, shaped, fit, dict.fromkeys(images, PERSON))


@pytest.fixture(scope="module")
def another_spine():
    return pictures_of(truth_of(-25.0, "lumbar"), np.random.default_rng(2))


def scaled(corners, factor):
    return replace(corners, corners=factor * corners.corners)


def test_a_sound_subject_passes_every_check(sound):
    checks = sound.checks()
    assert [check for check in checks if not check.passed] == []
    assert len({check.name for check in checks}) == len(checks) == 16
    assert all("\n" not in check.text and "look for" not in check.text for check in checks)
    # All is far from its limit here, so that a mix-up below is found for what it is.
    assert sound.check("rest and push").value < 0.25 * LIMITS.rest_mm
    assert sound.check("rest and push").value == pytest.approx(sound.pushes.poses["main"].rms_mm)
    assert sound.check("training frames").value < 0.4 * LIMITS.moved_mm


def fitted_otherwise(sound, **changed):
    return replace(sound, fit=replace(sound.fit, weighed=replace(sound.fit.weighed, **changed)))


def test_residuals_that_no_expected_error_explains(sound):
    assert sound.check("residuals as expected").value > 0.01
    case = fitted_otherwise(sound, p_value=2e-7, tracking_factor=2.5)
    text = case.doubts()["residuals as expected"]
    assert text.startswith(
        "the expected errors explain no such residuals (p = 2e-07); tracking's errors are 2.50 times "
    )
    assert "no vertebra is outlying (limit 0.001); look for exchanged forces" in text
    assert "pelvis" not in text
    assert fitted_otherwise(sound, p_value=1.1e-3).doubts() == {}


def test_a_pelvis_taken_as_level_is_named_among_the_causes(sound):
    case = fitted_otherwise(replace(sound, record=sound.record.model_copy(update={"pelvis": "level"})), p_value=2e-7)
    text = case.doubts()["residuals as expected"]
    assert "a pelvis that turned (subject.json's 'pelvis' takes it to be level)" in text


def test_as_many_ratios_as_residuals_leave_none_to_judge_by(sound):
    case = fitted_otherwise(sound, p_value=float("nan"))
    assert case.doubts() == {}
    assert case.check("residuals as expected").text == (
        "not possible: no residual is left to judge by: ratios and places in the picture take up all data"
    )


def test_outlying_vertebrae_are_named_and_alone_no_doubt(sound):
    outlying = (("push 'main' frame 2", "T7", 4.21), ("push 'main' frame 3", "T7", 3.0))
    case = fitted_otherwise(sound, outlying=outlying)
    assert case.doubts() == {}
    assert outlying_notes(case.fit) == (
        "push 'main' frame 2: T7 counts for less, its own error is 4.2 times what is usual",
        "push 'main' frame 3: T7 counts for less, its own error is 3.0 times what is usual",
    )
    assert "outlying are T7 (push 'main' frame 2, push 'main' frame 3)" in case.check("residuals as expected").text
    text = fitted_otherwise(sound, outlying=outlying, p_value=1e-5).doubts()["residuals as expected"]
    assert "look for the corners of T7, then for exchanged forces" in text


def test_equal_weights_expect_no_size_of_the_errors(sound):
    check = replace(sound, fit=replace(sound.fit, weighed=None)).check("residuals as expected")
    assert check.passed is None and "the paper's estimator" in check.text
    assert outlying_notes(replace(sound.fit, weighed=None)) == ()


@pytest.mark.slow
def test_a_vertebra_that_tracking_lost_is_told_by_the_residuals(sound):
    """For real: T8 tracked 5 mm aside in one training frame, fitted anew."""
    frames = [sound.tracked.corners(i) for i in range(len(FORCES))]
    shown = frames[2].corners.copy()
    shown[VERTEBRAE.index("T8"), :, 0] += 7.0
    frames[2] = replace(frames[2], corners=shown)
    case = replace(sound, tracked=TrackedPush.of(sound.tracked.view.view(), frames))
    fit = fit_pushes(case.pushes, ("lateral_bending", "tissue"), RATIOS, extent="estimate")
    case = replace(case, fit=fit)
    assert "look for the corners of T8, then" in case.doubts()["residuals as expected"]
    assert any(note.startswith("push 'main' frame 2: T8 counts for less") for note in outlying_notes(fit))


def test_pixel_spacing_wrong_everywhere(sound):
    small = {name: (scaled(corners, 0.7), view) for name, (corners, view) in sound.rest.items()}
    doubts = sound.with_rest(**small).with_frames(lambda corners: scaled(corners, 0.7)).doubts()
    assert set(doubts) == {"length of the spine", "sizes of the vertebrae"}
    # The prior takes back a little of so short a spine.
    assert re.match(r"the spine is 0\.7[0-3]\d times as long", doubts["length of the spine"])
    assert "(limit 0.893); look for a wrong height_cm, wrong pixel spacing" in doubts["length of the spine"]
    assert "look for wrong pixel spacing or distances" in doubts["sizes of the vertebrae"]


def test_pixel_spacing_of_the_pushes_alone(sound):
    doubts = sound.with_frames(lambda corners: scaled(corners, 0.9)).doubts()
    assert "look for pixel spacing or distances, the push being 0.9" in doubts["rest and push"]


def test_a_wrong_height(sound):
    tall = replace(sound, record=sound.record.model_copy(update={"height_cm": 190.0}))
    doubts = tall.with_rest(190.0).doubts()
    assert "times as long as the template's at 190 cm, as usual at 15" in doubts["length of the spine"]
    assert "look for a wrong height_cm" in doubts["length of the spine"]


def test_exchanged_forces(sound):
    doubts = sound.with_push(forces_n=(0.0, 20.0, 60.0, 40.0)).doubts()
    assert set(doubts) == {"motion grows with force"}
    text = doubts["motion grows with force"]
    assert text.startswith("push 'main': at 60 N (frame 2) the spine is bent ")
    assert "less than at 40 N (frame 3)" in text
    assert "look for exchanged forces" in text


def test_frames_of_the_same_force_need_not_grow(sound):
    forces, corners = (0.0, 20.0, 40.0, 40.0), [sound.tracked.corners(i) for i in (0, 1, 3, 2)]
    tracked = TrackedPush.of(sound.tracked.view.view(), corners)
    assert replace(sound.with_push(forces_n=forces), tracked=tracked).check("motion grows with force").passed
    forces = (0.0, 20.0, 40.0, 40.5)
    assert not replace(sound.with_push(forces_n=forces), tracked=tracked).check("motion grows with force").passed


def back_again(sound, forces, shown):
    """The subject with frames as if they had been taken in another order, or under other forces."""
    tracked = TrackedPush.of(sound.tracked.view.view(), [sound.tracked.corners(i) for i in shown])
    roles = (*ROLES[:3], *["unused"] * (len(forces) - 3))
    return replace(sound.with_push(forces_n=forces, roles=roles), tracked=tracked)


@pytest.mark.parametrize(
    ("forces", "shown", "said"),
    [
        ((0.0, 20.0, 40.0, 60.0, 40.0), (0, 1, 2, 3, 3), "at 40 N (frame 4) the spine is bent by 1"),
        ((0.0, 20.0, 40.0, 60.0, 0.0), (0, 1, 2, 3, 1), "at 0 N (frame 4) the spine is bent by "),
        ((0.0, 20.0, 40.0, 40.0), (0, 1, 2, 3), "at 40 N (frame 3) the spine is bent by 1"),
    ],
    ids=["on the way back", "without force again", "held"],
)
def test_creep_between_frames_of_the_same_force(sound, forces, shown, said):
    case = back_again(sound, forces, shown)
    # The frames of the way back are copies here, which is told, too.
    assert case.doubts().keys() - {"frames of their own"} == {"same force, same bending"}
    check = case.check("same force, same bending")
    assert check.text.startswith(f"push 'main': {said}")
    assert "look for creep between the frames or friction on the way back" in check.text
    assert check.value > 2.0 * check.limit


def test_the_same_way_back_passes(sound):
    same = back_again(sound, (0.0, 20.0, 40.0, 60.0, 40.0, 0.0), (0, 1, 2, 3, 2, 0)).check("same force, same bending")
    assert same.passed
    assert same.value == pytest.approx(0.0, abs=1e-9)


def test_a_force_read_a_little_otherwise_is_compared_where_the_way_up_had_it(sound):
    off = {}
    for force in (36.0, 38.0):
        case = back_again(sound, (0.0, 20.0, 40.0, 60.0, force), (0, 1, 2, 3, 2))
        off[force] = case.check("same force, same bending").value
    assert off[36.0] == pytest.approx(2.0 * off[38.0])
    assert off[38.0] > 0.1


def test_forces_that_only_grow_have_nothing_to_be_held_against(sound):
    for case in (sound, sound.with_push(forces_n=FORCES[::-1]), sound.with_push(forces_n=(0.0, 20.0, 60.0, 40.0))):
        assert "same force, same bending" not in [check.name for check in case.checks()]


def test_forces_in_reverse_order(sound):
    doubts = sound.with_push(forces_n=FORCES[::-1]).doubts()
    assert "forces in reverse order" in doubts["motion along the push"]


@pytest.mark.parametrize("off", [0.0, 0.001, 0.01])
def test_a_frame_that_is_a_copy_of_another_one(sound, off):
    corners = [sound.tracked.corners(i) for i in range(len(FORCES))]
    same = corners[2].corners + np.random.default_rng(3).normal(0.0, off, (17, 4, 2))
    quality = np.where(np.arange(17)[:, None] < 5, 0.0, corners[2].quality)
    corners[1] = replace(corners[2], corners=same, quality=quality)
    case = replace(sound, tracked=TrackedPush.of(sound.tracked.view.view(), corners))
    text = case.check("frames of their own").text
    if off == 0.01:
        assert text == "push 'main': no two frames of different force show the same"
    else:
        where = f"frames 1 and 2, at {FORCES[1]:g} and {FORCES[2]:g} N, show all corners at the same places"
        assert text.startswith(f"push 'main': {where} (limit 0.002); look for a picture stored twice")


@pytest.mark.parametrize("again", [40.0, 42.0])
def test_copies_under_about_the_same_force_say_nothing_wrong(sound, again):
    corners = [sound.tracked.corners(i) for i in (0, 1, 2, 2)]
    case = replace(sound, tracked=TrackedPush.of(sound.tracked.view.view(), corners))
    assert case.with_push(forces_n=(0.0, 20.0, 40.0, again)).check("frames of their own").passed


def test_the_wrong_side(sound):
    text = sound.with_push(side="right").doubts()["motion along the push"]
    assert "mm against the push from the right (limit 1); look for the wrong side in subject.json" in text


@pytest.mark.parametrize("turn", [1, -1])
def test_a_vertebra_of_a_push_turned_by_a_quarter(sound, turn):
    """Either its corners are no picture of a vertebra, or it stands out."""

    def turned(corners):
        new = np.array(corners.corners)
        new[7] = np.roll(new[7], turn, axis=0)
        return replace(corners, corners=new)

    case = sound.with_frames(turned)
    try:
        doubts = case.doubts()
    except TrackingError as error:
        words = "T8 lies upside down in the picture; check the corner order and the orientation"
        assert str(error) == f"push 'main' frame 0: {words}"  # noqa: PT017
        return
    assert "look for the corners of T8 in the annotated frames (order" in doubts["vertebrae of the push"]
    assert "look for wrong corners of T8 (0." in doubts["rest and push"]


@pytest.mark.parametrize("row", [0, 5, 16])
def test_a_displaced_vertebra_stands_out(sound, row):
    def displaced(corners):
        new = np.array(corners.corners)
        new[row] += 8.0
        return replace(corners, corners=new)

    case = sound.with_frames(displaced)
    assert f"look for the corners of {VERTEBRAE[row]}" in case.doubts()["vertebrae of the push"]


def test_levels_off_by_one_in_the_push_alone(sound):
    doubts = sound.with_frames(
        lambda corners: VertebraCorners(VERTEBRAE[1:], corners.corners[:-1], corners.quality[:-1])
    ).doubts()
    assert "look for levels of the push named one too far down (T8 as T9)" in doubts["rest and push"]


def test_rest_pictures_of_another_subject(sound, another_spine):
    doubts = sound.with_rest(**another_spine).doubts()
    assert "look for rest pictures of another person or visit" in doubts["rest and push"]


def test_a_frontal_rest_picture_that_is_mirrored(sound):
    corners, view = sound.rest["frontal"]
    new = np.array(corners.corners)[:, MIRRORED]
    new[..., 0] = 2.0 * view.principal_point[0] - new[..., 0]
    doubts = sound.with_rest(frontal=(replace(corners, corners=new), view)).doubts()
    assert "look for a mirrored picture, at rest or of the push (0." in doubts["rest and push"]


def test_the_pushed_frame_as_rest_picture(sound):
    case = sound.with_rest(frontal=(sound.tracked.corners(3), sound.tracked.view.view()))
    doubts = case.doubts()
    assert "look for a rest picture under load" in doubts["rest without load"]
    assert "look for a rest picture under load, as in frame 3 (60 N)" in doubts["rest and push"]


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1.0 / 9.81, "the largest training force is 4.08 N (limit 15); look for kilograms (1 kg is 9.81 N) or pounds"),
        (4.4, "the largest training force is 176 N (limit 150); look for newtons multiplied by 4.45 or 9.81"),
    ],
)
def test_forces_in_another_unit(sound, factor, words):
    doubts = sound.with_push(forces_n=tuple(factor * force for force in FORCES)).doubts()
    assert set(doubts) == {"size of the force"}
    assert doubts["size of the force"].startswith(words)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_what_cannot_be_told_passes(sound, factor):
    """Force and stiffness scaled together are the same state."""
    assert not sound.with_push(forces_n=tuple(factor * force for force in FORCES)).doubts()


def test_a_motion_that_the_fit_does_not_explain(sound):
    first, second = sound.fit.residuals
    fit = replace(sound.fit, residuals=(first, replace(second, difference=second.difference + 6.0)))
    doubts = replace(sound, fit=fit).doubts()
    assert set(doubts) == {"training frames"}
    assert "look for exchanged forces, forces of another push, the wrong rib level" in doubts["training frames"]


def test_a_vertebra_lost_in_tracking_stands_out(sound):
    still, moving = sound.fit.residuals
    off = np.array(moving.difference)
    off[4] += 5.0
    fit = replace(sound.fit, residuals=(still, replace(moving, difference=off)))
    doubts = replace(sound, fit=fit).doubts()
    assert re.match(
        r"push 'main' frame 2: the fit leaves \d\.\d\d mm \(RMS\) more of the motion of T5 than of its neighbours' "
        r"\(limit 1\.\d\d\); look for lost tracking of T5",
        doubts["vertebrae in motion"],
    )
    # What is known to be tracked badly hardly counts in the fit and is no reason to doubt it.
    weights = np.array(moving.quality)
    weights[4] = 0.05
    fit = replace(sound.fit, residuals=(still, replace(moving, difference=off, quality=weights)))
    assert not replace(sound, fit=fit).doubts()


def test_corners_that_scatter_at_rest(sound):
    shaped = replace(sound.shaped, corner_sd_mm=1.7)
    text = replace(sound, shaped=shaped).doubts()["corners at rest"]
    assert text.startswith("the corners in the rest pictures scatter by 1.70 mm about the shape found (limit 1.5); ")


def test_a_vertebra_set_aside_at_rest(sound):
    fits = {view: dict(seen) for view, seen in sound.shaped.fits.items()}
    fits["lateral"]["T9"] = replace(fits["lateral"]["T9"], wrong_corners=3)
    doubts = replace(sound, shaped=replace(sound.shaped, fits=fits)).doubts()
    assert doubts["vertebrae at rest"].startswith("T9 (lateral) contradicts the others")
    fits["lateral"]["T9"] = replace(fits["lateral"]["T9"], wrong_corners=1)
    assert not replace(sound, shaped=replace(sound.shaped, fits=fits)).doubts()


# What is missing


def test_without_a_frame_without_force(sound):
    case = sound.with_push(forces_n=(10.0, 20.0, 40.0, 60.0))
    checks = {check.name: check for check in case.checks()}
    of_rest = ("rest and push", "rest without load", "vertebrae of the push")
    for name in (*of_rest, "training frames", "vertebrae in motion"):
        assert checks[name].passed is None, name
        assert checks[name].text == "not possible: push 'main' has no usable frame without force"
    assert checks["motion grows with force"].passed
    assert checks["motion along the push"].passed
    assert not case.doubts()


def test_with_a_single_force(sound):
    case = sound.with_push(forces_n=(0.0, 20.0, 20.0, 20.0))
    assert case.check("motion grows with force").text == (
        "not possible: push 'main' has fewer than two forces above its least in usable frames"
    )


def seen_in_part(sound, rest, *loaded):
    """The sound subject where frames show these of the vertebrae alone, the unloaded one ``rest``."""
    frames = []
    for number, part in enumerate((rest, *loaded)):
        corners = sound.tracked.corners(number)
        quality = np.zeros_like(corners.quality)
        quality[part] = corners.quality[part]
        frames.append(replace(corners, quality=quality))
    case = replace(sound, tracked=TrackedPush.of(sound.tracked.view.view(), frames))
    pushes = case.pushes
    parts = tuple(
        residuals(pushes.torso, make_target(pushes.torso, item.trial), found.state)
        for item, found in zip(pushes.training, sound.fit.equilibria, strict=True)
    )
    return replace(case, fit=replace(sound.fit, residuals=parts))


@pytest.mark.parametrize("shared", [0, 1, 2])
def test_frames_that_share_few_vertebrae_with_the_unloaded_one_are_not_compared(sound, shared):
    """A spine that is seen in part, and another part under load: the estimate stands, and nothing is made up."""
    upper, lower = slice(0, 8), slice(8 - shared, 17)
    case = seen_in_part(sound, upper, lower, lower, lower)
    missing = {check.name: check.text for check in case.checks() if check.passed is None}
    assert missing["motion grows with force"].startswith("not possible: push 'main' has fewer than two forces")
    assert missing["rest without load"] == (
        "not possible: push 'main' has no usable frame under a force with 3 of its vertebrae"
    )
    for name in ("training frames", "vertebrae in motion"):
        assert missing[name] == (
            "not possible: no training frame shows 3 of the vertebrae of its push's frame without force"
        )
    assert ("motion along the push" in missing) == (shared == 0)
    assert case.doubts() == {}


def test_a_frame_that_shows_another_part_is_left_out_of_what_frames_are_compared_by(sound):
    """All others are judged as they are without it."""
    upper, lower, whole = slice(0, 8), slice(8, 17), slice(0, 17)
    case = seen_in_part(sound, upper, lower, whole, whole)
    assert [check.name for check in case.checks() if not check.passed] == []
    both = seen_in_part(sound, upper, upper, whole, whole)
    for name in ("motion along the push", "rest without load"):
        assert case.check(name) == both.check(name)


@pytest.mark.parametrize("nothing", [Identity(("", ""), None, False), replace(PERSON, removed=True)])
def test_files_that_name_no_patient(sound, nothing):
    case = replace(sound, identities={**sound.identities, "push/main": nothing})
    for name in ("same patient", "same visit"):
        assert case.check(name).passed is None
        assert case.check(name).text.startswith("not possible: a file ")


# Whose pictures, and when


def test_files_of_different_patients(sound):
    other = Identity(("another", "name and birth of another"), PERSON.day, False)
    doubts = replace(sound, identities={**sound.identities, "push/main": other}).doubts()
    assert doubts == {
        "same patient": "rest/frontal and push/main name different patients; look for a radiograph in the wrong "
        "folder, then for a patient registered twice"
    }


def test_different_patients_are_said_even_where_another_file_is_silent(sound):
    other = Identity(("another", ""), None, False)
    silent = Identity(("", ""), None, False)
    identities = {"rest/frontal": PERSON, "rest/lateral": silent, "push/main": other}
    assert set(replace(sound, identities=identities).doubts()) == {"same patient"}


def test_pictures_of_another_visit(sound):
    late = replace(PERSON, day=PERSON.day + 31)
    doubts = replace(sound, identities={**sound.identities, "push/main": late}).doubts()
    assert set(doubts) == {"same visit"}
    assert doubts["same visit"].startswith("rest/frontal and push/main were taken more than 30 days apart; look for")
    soon = replace(PERSON, day=PERSON.day - 30)
    assert not replace(sound, identities={**sound.identities, "push/main": soon}).doubts()
