"""Results as files: every one is read back as it was written, and what can't be one is refused."""

from __future__ import annotations

import inspect
import json
import math
from dataclasses import fields

import numpy as np
import pytest
from pydantic import ValidationError

from results import register
from spinestiff.errors import SpinestiffError
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.projection import XRayView, frontal_view, lateral_view
from spinestiff.imaging.tracking import SupportMotion
from spinestiff.subject import assessment_outcome, estimate_outcome, geometry_outcome, outcomes
from spinestiff.subject.annotation_record import Annotation
from spinestiff.subject.assessment_outcome import Assessment, Comparison
from spinestiff.subject.estimate_outcome import Check, Estimate, RatioEstimate
from spinestiff.subject.folder import Subject
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.outcome_parts import OutcomeFile, Quantity, ViewRecord, finite, nested
from spinestiff.subject.outcomes import FrameProposals, Measured, Responses, Tracked, TrackedPush
from spinestiff.subject.records import SubjectRecord
from spinestiff.subject.run_record import read_outcome, write_outcome

PUSH = {"id": "a", "side": "right", "level": 8, "d21_mm": 400, "d31_mm": 200, "frames": "a.dcm", "forces_n": [0, 20]}
NAMES = ("T7", "T8", "T9")


@pytest.fixture
def bare(tmp_path):
    record = SubjectRecord.model_validate(
        {"schema_version": 1, "id": "x", "age": 13, "sex": "female", "height_cm": 157, "pushes": [PUSH]}
    )
    return Subject(tmp_path, record, Annotation.model_validate({"schema_version": 1, "images": {}}))


def pose(**changed):
    return {"shift_mm": (1.25, -3.5), "roll_deg": 0.1 + 0.2, "yaw_deg": -1.0, "rms_mm": 0.375, **changed}


def corners(shift=0.0):
    quads = np.array([[[12.0, 10.0], [2.0, 10.0], [2.0, 20.0], [12.0, 20.0]]] * 3) + shift
    quads[:, :, 1] += 15.0 * np.arange(3)[:, None]
    return VertebraCorners(NAMES, quads, np.full((3, 4), 0.75))


def push(**said):
    return TrackedPush.of(frontal_view(), [corners(), corners(1.5)], **said)


def moving(**changed):
    """Supports in two frames: a pelvis that turned by 0.05 rad, a shoulder that went to the right."""
    two = np.array([False, True])
    pelvis = {
        "displacement": [[0.0, 0.0], [3.0, -1.0]], "error": [0.25, 0.3], "seen": ~two | two, "turn": [0.0, 0.05],
        "turn_error": [0.0, 0.002], "turn_seen": ~two | two, "off_axis": 0.1,
    }  # fmt: skip
    shoulder = {**pelvis, "displacement": [[0.0, 0.0], [-1.5, 7.0]], "turn_seen": two & ~two}
    return (SupportMotion("pelvis", **{**pelvis, **changed}), SupportMotion("shoulder", **{**shoulder, **changed}))


def examples():
    """One of each result, with numbers that have no short decimal form."""
    third = 1.0 / 3.0
    tracked = Tracked(
        pushes={
            "a": push(
                supports=moving(),
                millimetres={"pixel spacing": "DICOM"},
                annotated_frames=[0],
            )
        }
    )
    proposal = {
        "push": "a", "side": "right", "level": 8.0, "frame": 1, "force_n": 20.0, "sharpness": third,
        "contrast_to_noise": None, "saturated": 0.0, "vertebrae": 3, "tracking_mm": 0.25,
        "supports": {"pelvis": {"mm": 0.5, "degrees": None}}, "role": "unused", "proposed": "training", "reason": "é",
    }  # fmt: skip
    fit = {"rmse_mm": third, "centre_mm": 0.5, "angle_deg": 0.1, "wrong_corners": 0}
    scan = {
        "covered": 0.9, "used": third, "before_mm": (5.0, 9.0), "after_mm": (0.5, 1.5), "left_to_template": ("arms",),
        "held_mm": 0.0, "yaw_deg": 1.0, "tilt_deg": 2.0, "turned_round": False,
    }  # fmt: skip
    geometry = GeometryRecord.model_validate(
        {
            "rmse_mm": {"frontal": third}, "poses": {"frontal": pose()},
            "views": {"frontal": ViewRecord.of(frontal_view())}, "millimetres": {"frontal": {"pixel spacing": "DICOM"}},
            "fits": {"frontal": {"T8": fit}}, "prior_only": ("L5",), "carried": {"T8": ("yaw",)},
            "length_scale": 1.0 + third, "size_scale": {"T8": (1.0, third, 2.0)}, "corner_sd_mm": 0.3,
            "covariance": ((((third,) * 6,) * 6),), "skin_scan": scan, "warnings": ("L5 is in no radiograph",),
            "mesh": {"path": "finer", "nodes": 7, "smallest_j": third, "smallest_dihedral_deg": 9.0},
        }
    )  # fmt: skip
    ratio = RatioEstimate.of(third, (0.1, math.inf), (True, False), True)
    plain = {"value": third, "low": None, "high": None, "unit": "kPa", "ratio": None}
    estimate = Estimate.model_validate(
        {
            "status": "DOUBTFUL", "fit_status": "AT_BOUND", "fit_status_text": "at a bound",
            "determined": "not determined",
            "checks": (Check(name="a", value=None, limit=third, passed=None, text="not possible"),),
            "parameters": ("tissue",), "ratios": {"tissue": ratio}, "plain": {"tissue_young": plain},
            "covariance_log": ((None,),), "correlation": None, "region": ((third, 0.5),),
            "region_size": None, "training_rmse_mm": {"default": None, "fit": third}, "method": "weighed",
            "mesh": "coarse", "orientation": "covariance", "bounds": (0.005, 5.0), "poses": {"a": pose()},
            "notes": ("ü", ""),
            "reactions_n": {
                "push": "a", "f3": 20.0, "shoulder": third, "pelvis": 1.0, "pelvis_moment_nm": third,
                "wall_pull": 0.0, "eq2_shoulder": 2.0, "eq1_pelvis": 3.0,
            },
            "nuisances": (
                {
                    "name": "force of a", "group": "force scale", "unit": "", "value": third, "sd": 0.01,
                    "prior_sd": 0.02, "standard": 1.0,
                },
            ),
            "supports": ({"push": "a", "frame": 1, "obliquity_deg": third, "shoulder_mm": -1.0},),
            "sd_log": {"tissue": third}, "sd_log_tracking": {"tissue": 0.1},
            "budget": ({"name": "force scale", "alone": {"tissue": 0.2}, "without": {"tissue": third}},),
            "prior_changes": (
                {"name": "force scale", "factor": 0.5, "ratios": {"tissue": third}, "sd_log": {"tissue": 0.1}},
            ),
            "p_value": third, "tracking_factor": 1.0, "outlying": {"T8 in push 'a' frame 1": 3.0},
            "history": ({"ratios": {"tissue": third}, "loss": None, "rmse_mm": None, "accepted": False},),
            "cost": {"equilibria": 1, "newton_iterations": 2, "factorisations": 3, "seconds": third},
        }
    )  # fmt: skip
    change = {"signed": third, "fixed_levels": -1.0, "tilt": 0.5, "levels": ("T5", "T9"), "tilt_levels": ("T6", "L1")}
    held_out = {
        "push": "a", "frame": 1, "force_n": 20.0, "rmse_mm": {"rest": third, "truth": None},
        "cobb_change_deg": {"measured": change, "fit": None},
    }  # fmt: skip
    angle = {
        "levels": ("T5", "T11"), "frames": (0, 1), "rest_deg": 25.0, "change_deg": -third, "change_sd_deg": 0.5,
        "n_per_degree": {"value": None, "low": third, "high": None}, "scatter": None,
    }  # fmt: skip
    flexibility = {"percent": None, "low": None, "high": None}
    answered = {"force_n": 20.0, "tilt": angle, "curve": angle, "flexibility": flexibility}
    responses = Responses.model_validate({"gauge_scale_sd": third, "gauge_zero_sd_n": 1.5, "pushes": {"a": answered}})
    return [
        tracked,
        responses,
        FrameProposals.model_validate({"frames": (proposal,)}),
        geometry,
        estimate,
        Assessment.model_validate({"frames": (held_out,), "notes": ("the back wall pulls",)}),
        Comparison(truth={"tissue": third}, region_size=6.0, distance2=third, inside=True),
    ]


def test_there_is_an_example_of_every_result():
    kinds = {
        kind
        for module in (outcomes, geometry_outcome, estimate_outcome, assessment_outcome)
        for _, kind in inspect.getmembers(module, inspect.isclass)
        if issubclass(kind, OutcomeFile) and kind is not OutcomeFile
    }
    assert {type(example) for example in examples()} == kinds
    assert len({kind.FILE for kind in kinds}) == len(kinds)


@pytest.mark.parametrize("example", examples(), ids=lambda example: type(example).__name__)
def test_what_is_written_is_read_back(bare, example):
    write_outcome(bare, example)
    register(bare, example.STEP, example.FILE)
    found = read_outcome(bare, type(example))
    assert found == example
    before = (bare.results / example.FILE).read_bytes()
    write_outcome(bare, found)
    assert (bare.results / example.FILE).read_bytes() == before


@pytest.mark.parametrize("example", examples(), ids=lambda example: type(example).__name__)
def test_every_field_is_asked_for_and_no_other_is_known(example):
    content = json.loads(example.model_dump_json())
    with pytest.raises(ValidationError, match="extra_forbidden"):
        type(example).model_validate({**content, "colour": "red"})
    needed = [name for name, field in type(example).model_fields.items() if field.is_required()]
    assert needed
    for name in needed:
        with pytest.raises(ValidationError, match="missing"):
            type(example).model_validate({key: value for key, value in content.items() if key != name})
    with pytest.raises(ValidationError, match="schema_version"):
        type(example).model_validate({**content, "schema_version": 99})


@pytest.mark.parametrize("example", examples(), ids=lambda example: type(example).__name__)
def test_results_do_not_change(example):
    with pytest.raises(ValidationError, match="frozen"):
        example.schema_version = 3


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_refused(wrong):
    for make in (
        lambda: Quantity(value=wrong, low=None, high=None),
        lambda: Comparison(truth={"tissue": wrong}, region_size=None, distance2=None, inside=None),
        lambda: Comparison(truth={}, region_size=wrong, distance2=None, inside=None),
        lambda: Check(name="a", value=wrong, limit=None, passed=True, text=""),
        lambda: RatioEstimate.of(wrong, (0.1, 0.2), (False, False), False),
        lambda: Measured(value=wrong, sd=1.0),
        lambda: Measured(value=0.0, sd=wrong),
    ):
        with pytest.raises(ValidationError, match="finite"):
            make()


def test_a_number_that_got_past_the_schema_is_never_written(bare):
    """``model_construct`` checks nothing; the writer does."""
    with pytest.raises(SpinestiffError, match=r"comparison\.json is not written"):
        write_outcome(bare, Comparison.model_construct(truth={}, region_size=math.nan, distance2=None, inside=None))
    assert not bare.results.exists()


# Parts


@pytest.mark.parametrize(
    "view", [frontal_view(source_to_patient=1333.3), lateral_view(), frontal_view().moved((3.0, -2.0), 0.05)]
)
def test_a_view_comes_back_exactly(view):
    again = ViewRecord.model_validate_json(ViewRecord.of(view).model_dump_json()).view()
    for field in fields(XRayView):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(view, field.name), strict=False)


def test_corners_come_back_to_a_thousandth_of_a_pixel():
    view, wanted = frontal_view(), corners(1.5)
    found = push().corners(1)
    assert found.vertebrae == wanted.vertebrae
    np.testing.assert_allclose(view.pixels(found.corners), view.pixels(wanted.corners), atol=0.00051)
    np.testing.assert_array_equal(found.quality, wanted.quality)


def test_where_the_supports_are_is_part_of_a_frame():
    """In degrees and mm, with standard errors; the first frame is where they are measured from."""
    first, second = push(supports=moving()).frames
    assert (first.obliquity_deg, first.obliquity, first.shoulder_mm, first.support_note) == (None, None, None, "")
    assert first.support_motion_mm == {"pelvis": 0.0, "shoulder": 0.0}
    assert second.support_motion_mm == {"pelvis": pytest.approx(10.0**0.5, abs=1e-3), "shoulder": 1.5}
    assert second.obliquity.value == pytest.approx(0.05, abs=1e-6)
    assert second.obliquity.sd == pytest.approx(0.002, abs=1e-6)
    assert second.obliquity_deg.value == pytest.approx(math.degrees(0.05), abs=1e-4)
    assert (second.shoulder_mm.value, second.shoulder_mm.sd) == (-1.5, 0.3)
    assert second.support_note == "the pelvis moved by 3.2 mm, obliquity +2.9 degrees"


def test_supports_that_are_not_seen_have_no_place():
    nothing = np.zeros(2, dtype=bool)
    _, second = push(supports=moving(seen=nothing, turn_seen=nothing)).frames
    assert (second.obliquity_deg, second.shoulder_mm, second.support_motion_mm) == (None, None, {})
    assert second.support_note == ""


def test_a_measurement_without_error_is_refused():
    with pytest.raises(ValidationError, match="greater than 0"):
        Measured(value=1.0, sd=0.0)


def test_a_push_of_other_vertebrae_is_refused():
    content = json.loads(push().model_dump_json())
    content["vertebrae"].append("T10")
    with pytest.raises(ValidationError, match=r"frames\[0\].corners_px: 3 for 4 vertebrae"):
        TrackedPush.model_validate(content)
    with pytest.raises(ValidationError, match="frames: found none"):
        TrackedPush.model_validate({**content, "frames": []})


def test_ratios_and_their_names_agree():
    estimate = next(example for example in examples() if isinstance(example, Estimate))
    assert estimate.values == {"tissue": 1.0 / 3.0}
    with pytest.raises(ValidationError, match="parameters tissue, everything but ratios tissue"):
        Estimate.model_validate({**estimate.model_dump(), "parameters": ("tissue", "everything")})


def test_failed_checks_are_those_that_could_be_made():
    estimate = next(example for example in examples() if isinstance(example, Estimate))
    checks = [Check(name=str(passed), value=1.0, limit=0.5, passed=passed, text="") for passed in (True, False, None)]
    assert [check.name for check in estimate.model_copy(update={"checks": tuple(checks)}).failed] == ["False"]


# How far a value is known


def spanning(low, high, opens=(False, False), value=0.1):
    return Quantity(value=value, low=low, high=high, open_low=opens[0], open_high=opens[1])


@pytest.mark.parametrize(
    ("quantity", "word"),
    [
        (spanning(0.09, 0.11), "determined"),
        (spanning(0.0501, 0.1999), "determined"),
        (spanning(0.0499, 0.2001), "weakly determined"),
        (spanning(0.0101, 0.999), "weakly determined"),
        # Two decades, and more.
        (spanning(0.0099, 1.001), "not determined"),
        (spanning(0.005, 5.0), "not determined"),
        # The value may lie anywhere inside.
        (spanning(0.0501, 0.1999, value=0.06), "determined"),
        # An open end is no end: weakly at best, and none where both are.
        (spanning(0.09, 0.11, (True, False)), "weakly determined"),
        (spanning(0.09, 0.11, (False, True)), "weakly determined"),
        (spanning(0.0099, 1.001, (False, True)), "not determined"),
        (spanning(0.09, 0.11, (True, True)), "not determined"),
        (spanning(None, 0.11), "not determined"),
        (spanning(0.09, None), "not determined"),
        (spanning(0.0, 0.11), "not determined"),
    ],
)
def test_determination(quantity, word):
    assert quantity.determination == word
    assert RatioEstimate.of(
        quantity.value,
        tuple(math.nan if end is None else end for end in (quantity.low, quantity.high)),
        (quantity.open_low, quantity.open_high),
        False,
    ).determined == word  # fmt: skip


def test_a_scaled_quantity_keeps_its_open_ends_and_its_determination():
    scaled = spanning(0.05, 0.3, (False, True)).scaled(1000.0)
    assert (scaled.value, scaled.low, scaled.high) == (100.0, 50.0, 300.0)
    assert (scaled.open_low, scaled.open_high) == (False, True)
    assert spanning(None, 0.3).scaled(2.0).low is None
    assert spanning(0.05, 0.3).scaled(1000.0).determination == spanning(0.05, 0.3).determination


def test_the_spread_of_a_closed_interval():
    assert spanning(0.1 * math.exp(-0.2), 0.1 * math.exp(0.2)).sd_log == pytest.approx(0.1)
    assert spanning(0.05, 0.3, (True, False)).sd_log == math.inf
    assert spanning(None, 0.3).sd_log == math.inf


def test_ends_that_are_not_finite_count_as_not_found():
    found = RatioEstimate.of(0.1, (0.05, math.inf), (False, False), True)
    assert (found.low, found.high, found.at_bound, found.determined) == (0.05, None, True, "not determined")


def test_arrays_without_what_json_lacks():
    assert nested(np.array([[1.0, math.inf], [math.nan, 2.0]])) == [[1.0, None], [None, 2.0]]
    assert nested(3.0) == 3.0
    assert (finite(1.5), finite(math.nan), finite(-math.inf)) == (1.5, None, None)
