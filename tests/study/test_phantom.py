"""A bench phantom's pictures, made by mechanics of their own, and what the estimator says of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench_columns import documented, documented_text, pictures
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.curves.corner_files import ImageCorners, write_corners
from spinestiff.errors import SubjectError
from spinestiff.imaging.features import silhouette_shares, state_features
from spinestiff.study.phantom import (
    BenchJoint,
    _joints_sd,
    analyse,
    bench_joint,
    build_phantom,
    push_on,
    read_phantom,
)
from spinestiff.study.wording.phantom import phantom_lines
from spinestiff.subject.phantom_record import JointRecord

RUBBER = {"width_mm": 90.0, "depth_mm": 70.0, "young_mpa": 0.05, "young_sd_mpa": 0.001, "spacing_mm": 60.0}


def bench_values(record) -> np.ndarray:
    return np.array([joint.stiffness for joint in build_phantom(record).joints])


@pytest.fixture(scope="module")
def record():
    return documented()


@pytest.fixture(scope="module")
def as_measured(record):
    return analyse(record, pictures(record, bench_values(record)))


def test_known_joints_are_found_again(record, as_measured) -> None:
    (joints,) = as_measured.comparisons
    assert joints.verdict == "agrees" and as_measured.agrees
    assert (joints.bench, joints.unit) == (pytest.approx(bench_values(record).mean()), "N mm/rad")
    assert joints.low < joints.fit_low < joints.ratio < joints.fit_high < joints.high
    assert joints.ratio == pytest.approx(1.0, abs=0.06)
    assert joints.fit_high / joints.fit_low < 1.25
    assert as_measured.sound


def test_a_radiograph_magnifies_the_marks(record) -> None:
    distances = {"source_detector_mm": 1200.0, "source_marks_mm": 1000.0}
    radiograph = record.model_copy(update={"picture": record.picture.model_copy(update=distances)})
    found = analyse(radiograph, pictures(radiograph, bench_values(record)))
    assert found.agrees
    assert found.predicted[0].motion_mm == pytest.approx(13.2, abs=0.3)


def test_frames_that_were_not_fitted_are_predicted(as_measured) -> None:
    assert [frame.image for frame in as_measured.predicted] == ["T12 left 7", "L1 right 9"]
    for frame in as_measured.predicted:
        assert frame.motion_mm > 10.0
        assert frame.rmse_mm < 5.0 * as_measured.noise_mm


@pytest.mark.parametrize(("gauge", "word"), [(1.2, "high"), (0.8, "low")])
def test_a_wrong_gauge_is_told(record, gauge, word) -> None:
    found = analyse(record, pictures(record, bench_values(record), gauge=gauge))
    (joints,) = found.comparisons
    assert joints.ratio == pytest.approx(gauge, rel=0.06)
    assert joints.verdict == "does not agree" and not found.agrees
    lines = "\n".join(phantom_lines(found))
    assert "does NOT agree with the bench" in lines
    assert f"% {word} does this" in lines


def test_joints_softer_than_on_the_bench_are_told(record) -> None:
    found = analyse(record, pictures(record, 0.7 * bench_values(record)))
    assert found.comparisons[0].ratio == pytest.approx(0.7, rel=0.06)
    softer = f"{100 * (1.0 - found.comparisons[0].ratio):.0f} % softer than measured there"
    assert softer in "\n".join(phantom_lines(found))


def test_the_mean_s_error_is_that_of_joints_of_any_stiffness(record) -> None:
    joints = (BenchJoint("T12", 1000.0, 0.3), BenchJoint("L1", 9000.0, 0.1))
    drawn = np.random.default_rng(0).normal([1000.0, 9000.0], [300.0, 900.0], (100_000, 2)).mean(axis=1)
    alone = record.model_copy(update={"bench_scale_sd": 0.0})
    assert _joints_sd(alone, joints) == pytest.approx(drawn.std() / 5000.0, rel=0.01)


def test_an_error_of_the_bench_widens_the_comparison_alone() -> None:
    sure, unsure = (documented(bench_scale_sd=sd) for sd in (0.0, 0.2))
    seen = pictures(sure, 1.2 * bench_values(sure))
    (narrow,), (wide,) = (analyse(one, seen).comparisons for one in (sure, unsure))
    assert (narrow.fit_low, narrow.fit_high) == (wide.fit_low, wide.fit_high)
    assert (narrow.verdict, wide.verdict) == ("does not agree", "agrees")
    assert wide.high / wide.ratio == pytest.approx(
        np.exp(np.hypot(np.log(wide.fit_high / wide.ratio), 1.96 * wide.bench_sd)), rel=1e-6
    )


def test_the_other_side_is_not_taken_for_agreement(record) -> None:
    frames = [
        frame.model_copy(update={"side": {"left": "right", "right": "left", None: None}[frame.side]})
        for frame in record.frames
    ]
    found = analyse(record.model_copy(update={"frames": tuple(frames)}), pictures(record, bench_values(record)))
    assert not found.agrees
    assert "moved against the push" in "\n".join(found.warnings)


def test_forces_that_move_nothing_tell_nothing(record) -> None:
    frames = tuple(frame.model_copy(update={"force_n": 1e-3 * frame.force_n}) for frame in record.frames)
    weak = record.model_copy(update={"frames": frames, "errors": {"force_offset_n": 0.0}})
    found = analyse(weak, pictures(weak, bench_values(record)))
    (joints,) = found.comparisons
    assert joints.verdict == "can't be told" and not found.agrees
    assert joints.open_low or joints.open_high
    lines = "\n".join(phantom_lines(found))
    assert "can't be told from these pictures" in lines
    # In both intervals, of the pictures and with the bench's error.
    assert [lines.count(sign) for sign in "≤≥"] == [2 * joints.open_low, 2 * joints.open_high]


def test_rubber_has_a_ratio_of_its_own() -> None:
    """Rubber of twice the modulus that its bars had, on joints a quarter as stiff; a coarse mesh, the same for both."""
    soft = [
        {**joint.model_dump(mode="json"), "turns_deg": [4.0 * turn for turn in joint.turns_deg]}
        for joint in documented().joints
    ]
    stated = documented(joints=soft, rubber=RUBBER)
    phantom = build_phantom(stated)
    torso, view, random = phantom.torso, phantom.view, np.random.default_rng(0)
    shares = silhouette_shares(torso, view, torso.rest_pose)
    truth = stiffness_ratios({"tissue": 2.0}, torso.joints.kinds)
    seen = []
    for frame in stated.frames:
        state = phantom.problem.solve(push_on(torso, frame), truth).require().state
        corners = state_features(torso, view, state, shares).corners + random.normal(0.0, 0.1, (6, 4, 2))
        seen.append(ImageCorners(frame.image, stated.levels, view.pixels(corners)[:, [1, 0, 3, 2]]))
    found = analyse(stated, seen)
    joints, rubber = found.comparisons
    assert (joints.part, rubber.part) == ("joints, mean", "rubber")
    assert joints.verdict == "agrees"
    assert rubber.verdict == "does not agree"
    assert rubber.fit_low < 2.0 < rubber.fit_high


@pytest.mark.parametrize("fault", ["pixel_mm", "gap_mm"])
def test_millimetres_that_are_wrong_are_told(record, fault) -> None:
    """Tilts do not depend on them, so that the ratio stays and the residuals must tell."""
    seen = pictures(record, bench_values(record))
    picture = record.picture.model_copy(update={"pixel_mm": 0.165})
    wrong = {"pixel_mm": {"picture": picture}, "gap_mm": {"gap_mm": 14.0}}[fault]
    found = analyse(record.model_copy(update=wrong), seen)
    assert not found.sound and not found.agrees
    assert "the pictures do NOT fit the phantom" in "\n".join(phantom_lines(found))


# Bench measurements


def test_a_joint_is_the_slope_of_its_line() -> None:
    moments = (100.0, 200.0, 400.0, 500.0)
    turns = tuple(float(np.degrees(0.01 + m / 8000.0)) for m in moments)
    joint = bench_joint(JointRecord(block="L1", moments_nmm=moments, turns_deg=turns))
    assert joint.stiffness == pytest.approx(8000.0)
    assert joint.sd == pytest.approx(0.0, abs=1e-9)


def test_a_joints_error_is_that_of_its_slope() -> None:
    random, moments = np.random.default_rng(3), np.linspace(100.0, 1000.0, 10)
    found = []
    for _ in range(300):
        turns = np.degrees(moments / 8000.0) + random.normal(0.0, 0.1, 10)
        found.append(bench_joint(JointRecord(block="L1", moments_nmm=tuple(moments), turns_deg=tuple(turns))))
    scatter = np.std([joint.stiffness for joint in found]) / 8000.0
    assert np.mean([joint.sd for joint in found]) == pytest.approx(scatter, rel=0.1)


def test_turns_against_the_moment_are_refused() -> None:
    joint = JointRecord(block="L1", moments_nmm=(1.0, 2.0, 3.0, 4.0), turns_deg=(-1.0, -2.0, -3.0, -4.0))
    with pytest.raises(SubjectError, match=r"phantom.json: joint below L1: turns do not grow with the moment"):
        bench_joint(joint)


# Files


@pytest.fixture
def folder(tmp_path, record):
    (tmp_path / "phantom.json").write_text(documented_text(), encoding="utf-8")
    write_corners(tmp_path / "corners.csv", pictures(record, bench_values(record)))
    return tmp_path


def test_a_folder_is_read_in_the_order_of_its_frames(folder, record) -> None:
    seen = pictures(record, bench_values(record))
    write_corners(folder / "corners.csv", seen[::-1])
    read, images = read_phantom(folder)
    assert read == record
    assert [image.image for image in images] == [frame.image for frame in record.frames]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"nme": 1}, r"nme: unknown key; did you mean name\?"),
        ({"colour": 1}, "colour: unknown key; check its spelling against docs/bench-phantom.md"),
        ({"levels": ["T12", "L1", "L2"]}, "joints of 6 blocks; wanted one below each of T12, L1, L2"),
        ({"levels": ["T12", "L1", "L2", "L3", "L4", "L4"]}, "levels: 'L4' is given twice"),
        (
            {"levels": ["L5", "L4", "L3", "L2", "L1", "T12"]},
            "levels: L5 is above L4; wanted the blocks from top to bottom",
        ),
        ({"frames": [{"image": "rest", "force_n": 0.0}] * 2}, "frames: 'rest' is given twice"),
        (
            {"frames": [{"image": "a", "force_n": 0.0}, {"image": "b", "force_n": 3.0}]},
            r"frames\[1\]: wanted block and side with a force_n above 0",
        ),
        (
            {"frames": [{"image": "a", "force_n": 0.0}, {"image": "b", "force_n": 0.0}]},
            "frames: wanted one without force and one with a force to fit",
        ),
        (
            {
                "frames": [
                    {"image": "a", "force_n": 0.0},
                    {"image": "b", "force_n": 3.0, "block": "T3", "side": "left"},
                ]
            },
            r"frames\[1\].block: T3 is none of the levels",
        ),
        (
            {"joints": [{"block": "L1", "moments_nmm": [1.0, 2.0, 3.0, 4.0], "turns_deg": [1.0] * 5}]},
            r"joints\[0\]: 4 moments_nmm but 5 turns_deg",
        ),
        (
            {"joints": [{"block": "L1", "moments_nmm": [1.0, 1.0, 3.0, 4.0], "turns_deg": [1.0] * 4}]},
            "fewer than 4 different moments_nmm",
        ),
    ],
)
def test_a_record_that_does_not_fit_is_refused(folder, changes, words) -> None:
    (folder / "phantom.json").write_text(documented_text(**changes), encoding="utf-8")
    with pytest.raises(SubjectError, match=words):
        read_phantom(folder)


def test_an_unknown_or_impossible_error_is_refused(record) -> None:
    for errors, text in (
        ({"force": 0.1}, r"^phantom.json: errors.force: unknown prior; wanted one of annotation_mm, "),
        ({"annotation_mm": 0.0}, r"^phantom.json: errors: prior annotation_mm "),
    ):
        strange = record.model_copy(update={"errors": errors})
        with pytest.raises(SubjectError, match=text):
            analyse(strange, pictures(record, bench_values(record)))


def test_pictures_that_do_not_fit_are_refused(folder, record) -> None:
    seen = pictures(record, bench_values(record))
    write_corners(folder / "corners.csv", seen[1:])
    with pytest.raises(SubjectError, match=r"corners.csv: rest: no corners of this frame of phantom.json"):
        read_phantom(folder)
    named = [replace(image, levels=("T1", *image.levels[1:])) for image in seen]
    write_corners(folder / "corners.csv", named)
    with pytest.raises(SubjectError, match=r"corners.csv: rest: T1 is none of the phantom's levels"):
        read_phantom(folder)
    with pytest.raises(SubjectError, match="none: no such folder"):
        read_phantom(folder / "none")
    with pytest.raises(SubjectError, match=r"corners\.csv: no folder; wanted one with phantom\.json"):
        read_phantom(folder / "corners.csv")
    (folder / "empty").mkdir()
    with pytest.raises(SubjectError, match=r"phantom\.json: no such file; write it as docs/bench-phantom\.md shows"):
        read_phantom(folder / "empty")
    (folder / "corners.csv").unlink()
    with pytest.raises(SubjectError, match=r"corners\.csv: no such file; write it as docs/bench-phantom\.md shows"):
        read_phantom(folder)
    with pytest.raises(SubjectError, match=r"corners.csv: rest: corners in mm; wanted pixels"):
        analyse(record, [replace(image, unit="mm", first_on="right") for image in seen])
    mirrored = replace(seen[1], corners=seen[1].corners[:, [1, 0, 3, 2]])
    with pytest.raises(SubjectError, match=r"corners.csv: T12 right 4: corners of T12 are mirrored"):
        analyse(record, [seen[0], mirrored, *seen[2:]])


def test_a_held_out_picture_without_a_block_of_the_one_at_rest_is_refused(record) -> None:
    seen = pictures(record, bench_values(record))
    count = len(record.levels) // 2
    apart = [
        replace(image, levels=image.levels[part], corners=image.corners[part])
        for frame, image in zip(record.frames, seen)
        for part in [slice(count, None) if frame.use == "predict" else slice(0, count)]
    ]
    shown = r"corners.csv: T12 left 7: shows L3, L4, L5, and 'rest', the picture without a push .* T12, L1, L2; mark a"
    with pytest.raises(SubjectError, match=shown):
        analyse(record, apart)
    # One block is enough, and a picture that is fitted needs none.
    first, held_out = apart[0], [image for frame, image in zip(record.frames, seen) if frame.use == "predict"]
    assert set(held_out[0].levels) > set(first.levels)
    found = analyse(record, [seen[0], *apart[1:]])
    assert len(found.predicted) == len(held_out)
