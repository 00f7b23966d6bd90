"""spinestiff.arrays: what holds large arrays says so in one short line, and is copied by its fields."""

from __future__ import annotations

import copy
import enum
import pickle
from dataclasses import dataclass, field

import numpy as np
import pytest

from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.arrays import ShortRepr
from spinestiff.estimation.discrepancy_data import shipped_data
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports


class Colour(enum.Enum):
    RED = "a long explanation"


@dataclass(frozen=True, repr=False)
class Part(ShortRepr):
    big: np.ndarray
    few: np.ndarray
    names: tuple[str, ...]
    colour: Colour
    share: float
    inner: object
    table: dict[str, int]
    hidden: int = field(default=7, repr=False)


def test_arrays_are_told_by_shape_parts_by_type_and_long_lists_by_length():
    inner = Part(np.zeros(9), np.zeros(2), (), Colour.RED, 0.5, None, {})
    part = Part(np.zeros((49, 3)), np.array([1, 2]), ("a", "b"), Colour.RED, 1 / 3, inner, {"x": 1})
    assert repr(part) == (
        "Part(big=<49x3>, few=[1, 2], names=('a', 'b'), colour=RED, share=0.333333, inner=<Part>, table=<1 of dict>)"
    )
    assert "names=<4 of tuple>" in repr(Part(*[np.zeros(0)] * 2, tuple("abcd"), Colour.RED, 0.0, None, {}))


def test_a_long_line_is_cut():
    text = repr(Part(np.zeros(9), np.zeros(9), ("x" * 90, "y" * 90), Colour.RED, 0.0, None, {}))
    assert len(text) == ShortRepr.LONGEST and text.endswith(" ...)")


@pytest.fixture(scope="module")
def case():
    torso = template_torso(157.0, "coarse")
    problem = EquilibriumProblem(torso, three_point_supports(torso, "right"))
    load, ratios = rib_push(torso, "right", 8.0, 5.0, label="pushed"), stiffness_ratios({"tissue": 0.5})
    return torso, problem, load, ratios, problem.solve(load, ratios)


def test_a_torso_and_its_equilibrium_print_one_short_line_each(case):
    torso, problem, load, ratios, found = case
    supports = problem.supports
    for thing in (torso, torso.joints, torso.tissue, torso.rest_pose, problem, supports, supports.springs, found):
        assert len(repr(thing)) <= ShortRepr.LONGEST, type(thing)
        assert "\n" not in repr(thing)
        assert repr(thing).startswith(f"{type(thing).__name__}(")
    assert repr(torso).startswith("TorsoModel(157 cm, 49 bones, 67 joints, ")
    assert repr(torso.rest_pose).startswith("TorsoState(49 bones, ")
    assert repr(problem).startswith(f"EquilibriumProblem(49 bones, {problem.potential.dofs} unknowns, 6 held, ")
    assert repr(load) == "LoadCase('pushed', 5 N at 2 points and 0 tissue nodes)"
    assert repr(ratios) == "StiffnessRatios(tissue=0.5)"
    assert repr(found).startswith("Equilibrium(CONVERGED, energy ")


def test_a_failed_equilibrium_says_what_is_at_fault(case):
    _, problem, load, _, _ = case
    failed = problem.solve(load, max_iterations=0)
    assert repr(failed).startswith("Equilibrium(ITERATION_LIMIT, ")
    assert "force of" in repr(failed) and failed.fault[:30] in repr(failed)


def test_what_is_sent_to_another_process_arrives_as_it_was_and_protected() -> None:
    torso = template_torso(157.0, "coarse")
    view = frontal_view(shape=(4, 3), pixel=1.0)
    picture = Radiograph(np.ones((4, 3)), view, source="a.dcm", provenance={"millimetres": "ImagerPixelSpacing"})
    for copied in (pickle.loads(pickle.dumps(picture)), copy.deepcopy(picture)):
        assert (copied.source, dict(copied.provenance)) == ("a.dcm", {"millimetres": "ImagerPixelSpacing"})
        np.testing.assert_array_equal(copied.pixels, picture.pixels)
        with pytest.raises(ValueError, match="read-only"):
            copied.pixels[0, 0] = 2.0
        with pytest.raises(TypeError, match="does not support item assignment"):
            copied.provenance["millimetres"] = "guessed"
    body = pickle.loads(pickle.dumps(torso))
    assert list(body.landmarks) == list(torso.landmarks)
    np.testing.assert_array_equal(body.tissue.rest_positions, torso.tissue.rest_positions)
    learnt = pickle.loads(pickle.dumps(shipped_data()))
    assert list(learnt.kinds) == list(shipped_data().kinds)
    inner = (
        picture.view.source,
        body.tissue.rest_positions,
        body.rest_pose.bone_positions,
        body.bone_surfaces[0].vertices,
        body.joints.stiffness,
        body.landmark("wall").offset,
        next(iter(learnt.kinds.values())).modes,
    )
    assert not any(array.flags.writeable for array in inner)
