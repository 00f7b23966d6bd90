"""Shaping the template: a known deformation is found from two projections, and the result is at rest."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.template import template_torso
from spinestiff.errors import EquilibriumError, TorsoError
from spinestiff.imaging.features import VertebraCorners, silhouette_choice, state_features
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import no_load, rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.personalise import shape
from spinestiff.personalise.shape import personalise, place_vertebrae
from spinestiff.study.spines import curved_spine, rest_vertebrae

MOVED = {"frontal": ((5.0, -3.0), 0.02), "lateral": ((-4.0, 2.0), -0.015)}
HIDDEN = {"frontal": ("T1", "T2"), "lateral": ("T1", "T3", "L5")}


def annotated(torso, view, names):
    """What is seen of a torso at rest, without error."""
    choice = silhouette_choice(torso, view, torso.rest_pose)
    corners = state_features(torso, view, torso.rest_pose, choice).corners
    return VertebraCorners(torso.vertebrae, corners).selected(names)


@pytest.fixture(scope="module")
def template():
    return template_torso(157.0, "coarse")


@pytest.fixture(scope="module")
def girl(template):
    """The template with a curve of 10 degrees and 3 mm taken out of its kyphosis."""
    positions, rotations = curved_spine(template, 10.0, "thoracic")
    height = np.linspace(1.0, 0.0, len(positions))
    return place_vertebrae(template, positions + np.outer(np.sin(np.pi * height), [0.0, 0.0, 3.0]), rotations)


@pytest.fixture(scope="module")
def lines():
    return []


@pytest.fixture(scope="module")
def shaped(template, girl, lines):
    pictures = {}
    for name, make in (("frontal", frontal_view), ("lateral", lateral_view)):
        seen = tuple(v for v in template.vertebrae if v not in HIDDEN[name])
        pictures[name] = (annotated(girl, make().moved(*MOVED[name]), seen), make())
    return personalise(template, pictures, lines.append)


def test_placed_vertebrae_are_where_they_were_wanted(template):
    wanted = curved_spine(template, 15.0, "lumbar")
    placed = place_vertebrae(template, *wanted)
    positions, rotations = rest_vertebrae(placed)
    assert np.abs(rest_vertebrae(template)[0] - wanted[0]).max() > 3.0
    assert np.abs(positions - wanted[0]).max() < 0.05
    assert np.abs(rotations - wanted[1]).max() < 0.005
    assert placed.height_cm == template.height_cm


def test_both_pictures_are_met(shaped):
    assert set(shaped.rmse_mm) == {"frontal", "lateral"}
    assert max(shaped.rmse_mm.values()) < 0.3
    for name, values in shaped.vertebra_rmse_mm.items():
        assert not set(values) & set(HIDDEN[name])
        assert max(values.values()) < 1.0


def test_the_vertebrae_are_where_the_subjects_are(template, girl, shaped):
    """In 3D, seen in both pictures: corners of the boxes to within 0.3 mm RMSE, from 5 mm before."""

    def boxes(torso):
        rows = [torso.vertebrae.index(v) for v in ("T4", "T6", "T8", "T10", "T12", "L2", "L4")]
        positions, rotations = rest_vertebrae(torso)
        corners = positions[:, None] + np.einsum("vij,vkj->vki", rotations, torso.vertebra_boxes)
        return corners[rows]

    # Views only fix the torso up to a rigid motion that all views share: compare shapes.
    def aligned(points, goal):
        a, b = points.reshape(-1, 3), goal.reshape(-1, 3)
        u, _, vt = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
        turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
        return ((a - a.mean(0)) @ turn + b.mean(0)).reshape(points.shape)

    goal = boxes(girl)
    before, after = (
        float(np.sqrt(np.mean(np.sum((aligned(boxes(t), goal) - goal) ** 2, -1)))) for t in (template, shaped.torso)
    )
    assert before > 2.0
    assert after < 0.3


def test_a_shift_is_the_views_and_a_lean_the_torsos(template, shaped):
    """Where the patient stood is found; a roll of the whole picture is taken for the person's own lean."""
    views = {"frontal": frontal_view(), "lateral": lateral_view()}
    pictures = {n: (annotated(template, v.moved(*MOVED[n]), template.vertebrae), v) for n, v in views.items()}
    leaning = personalise(template, pictures)
    turn = rest_vertebrae(leaning.torso)[1] @ np.swapaxes(rest_vertebrae(template)[1], 1, 2)
    # In the picture rows grow downward: a roll is a turn about minus z (frontal) and plus x (lateral).
    lean = {"frontal": -np.arctan2(turn[:, 1, 0], turn[:, 0, 0]), "lateral": np.arctan2(turn[:, 2, 1], turn[:, 1, 1])}
    for name, (shift, roll) in MOVED.items():
        pose = leaning.poses[name]
        assert pose.shift == pytest.approx(shift, abs=0.6)
        assert abs(pose.roll) < 0.3 * abs(roll)
        assert lean[name].mean() + pose.roll == pytest.approx(roll, abs=0.003)
        # Heights are no part of the curve.
        assert shaped.poses[name].shift[1] == pytest.approx(shift[1], abs=0.3)
        assert shaped.views[name].source_to_patient == views[name].source_to_patient


def test_hidden_vertebrae_are_named(shaped):
    assert shaped.prior_only == ("T1",)


def test_each_annealing_step_is_told(shaped, lines):
    assert len(lines) == 1 + len(shape.ANNEALING)
    assert lines[0].startswith("image weight 0 N/mm: frontal ")
    assert lines[-1].startswith("image weight 300 N/mm")


def test_the_result_is_free_of_stress(shaped):
    torso = shaped.torso
    problem = EquilibriumProblem(torso, three_point_supports(torso, "left"))
    found = problem.solve(no_load()).require()
    assert np.abs(found.state.bone_positions - torso.rest_pose.bone_positions).max() < 1e-8
    assert np.abs(found.state.tissue_positions - torso.rest_pose.tissue_positions).max() < 1e-8
    assert np.abs(problem.potential.gradient(torso.rest_pose, problem.potential.stiffness(None), ())).max() < 1e-7
    pushed = problem.solve(rib_push(torso, "left", 8.0, 10.0)).require()
    assert np.abs(pushed.state.bone_positions - torso.rest_pose.bone_positions).max() > 0.1


def test_wanted_places_out_of_reach_end_in_one_error(template, monkeypatch):
    """A spine twisted into its neighbours turns elements over; nothing but a plain refusal comes of it."""
    positions, rotations = rest_vertebrae(template)
    monkeypatch.setattr(
        shape.EquilibriumProblem,
        "solve",
        lambda self, *args, solve=shape.EquilibriumProblem.solve, **kwargs: solve(
            self, *args, **{**kwargs, "max_iterations": 2}
        ),
    )
    with pytest.raises((EquilibriumError, TorsoError), match=r"can't be brought to the radiographs"):
        place_vertebrae(template, positions * [1.0, -1.0, 1.0], rotations)
