"""Perspective views: exact magnification, round trips, derivatives, conventions."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.errors import RadiographError
from spinestiff.imaging.projection import FRONT, LEFT, UP, XRayView, frontal_view, lateral_view, placed_view

VIEWS = {"frontal": frontal_view(), "lateral": lateral_view()}


def oblique_view(distance: float = 1400.0) -> XRayView:
    """Detector turned about all three axes, principal ray off its centre, pixels not square."""
    turn = exp_so3(np.array([0.3, -0.5, 0.2]))
    axes = turn[:, :2].T
    origin = np.array([-150.0, 380.0, 40.0])
    source = origin + axes.T @ np.array([130.0, 260.0]) - distance * np.cross(axes[0], axes[1])
    return XRayView(source, origin, axes, np.array([0.4, 0.5]), (900, 800), 0.9 * distance)


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(3).uniform(-150.0, 150.0, (40, 3)) + [0.0, 200.0, 0.0]


@pytest.mark.parametrize(("depth", "wanted"), [(100.0, 15.0 / 14.0), (200.0, 15.0 / 13.0), (0.0, 1.0)])
def test_a_point_at_a_depth_is_magnified_by_sdd_over_what_is_left(depth: float, wanted: float) -> None:
    view = frontal_view(sid=1500.0, source_to_patient=1340.0, centre=(0.0, 0.0, 0.0))
    points = np.array([[0.0, 0.0, -160.0 + depth], [1.0, 0.0, -160.0 + depth]])
    u = view.project(points)[:, 0]
    assert u[1] - u[0] == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize("view", [*VIEWS.values(), oblique_view()])
def test_projection_agrees_with_the_ray_from_source_to_detector(view: XRayView, points: np.ndarray) -> None:
    ray = points - view.source
    length = view.source_to_detector / (ray @ view.normal)
    hit = view.source + length[:, None] * ray
    np.testing.assert_allclose(view.detector_point(view.project(points)), hit, atol=1e-10)


@pytest.mark.parametrize("view", [*VIEWS.values(), oblique_view()])
def test_detector_plane_and_pixels_go_there_and_back(view: XRayView, points: np.ndarray) -> None:
    uv = view.project(points)
    np.testing.assert_allclose(view.from_patient_plane(view.to_patient_plane(uv)), uv, rtol=1e-12)
    np.testing.assert_allclose(view.from_pixels(view.pixels(uv)), uv, rtol=1e-12)
    np.testing.assert_allclose(view.project(view.detector_point(uv)), uv, rtol=1e-12)


def test_a_source_at_infinity_is_orthographic(points: np.ndarray) -> None:
    view = oblique_view(distance=1e15)
    wanted = (points - view.detector_origin) @ view.detector_axes.T
    np.testing.assert_allclose(view.project(points), wanted, atol=1e-9)


@pytest.mark.parametrize("view", [*VIEWS.values(), oblique_view(), oblique_view().moved((4.0, -7.0), 0.08)])
def test_jacobian_is_the_complex_step_derivative(view: XRayView, points: np.ndarray) -> None:
    uv, jacobian = view.project_with_jacobian(points)
    np.testing.assert_array_equal(uv, view.project(points))
    for axis in range(3):
        step = np.zeros(3, dtype=complex)
        step[axis] = 1e-30j
        np.testing.assert_allclose(jacobian[..., axis], view.project(points + step).imag / 1e-30, atol=1e-13)


def test_whole_pixel_coordinates_are_pixel_centres() -> None:
    view = frontal_view(shape=(4, 6), pixel=(0.5, 0.25), centre=(0.0, 0.0, 0.0))
    np.testing.assert_allclose(view.pixels(view.project(view.detector_origin)), [0.0, 0.0], atol=1e-12)
    # The principal ray hits the middle of an even grid: between columns 2 and 3, between rows 1 and 2.
    np.testing.assert_allclose(view.pixels(view.project([0.0, 0.0, 0.0])), [2.5, 1.5], atol=1e-12)
    np.testing.assert_allclose(view.from_pixels([5.0, 3.0]), [2.5, 0.75], atol=1e-12)


def test_frontal_view_shows_patient_left_at_growing_columns_and_superior_at_small_rows() -> None:
    view = VIEWS["frontal"]
    middle, left, up, front = view.pixels(view.project([200.0 * UP, 200.0 * UP + LEFT, 201.0 * UP, 200.0 * UP + FRONT]))
    assert left[0] > middle[0] and left[1] == pytest.approx(middle[1])
    assert up[1] < middle[1] and up[0] == pytest.approx(middle[0])
    np.testing.assert_allclose(front, middle, atol=1e-9)
    # Source in front: what is anterior is magnified more.
    assert view.project(50.0 * LEFT + 50.0 * FRONT)[0] > view.project(50.0 * LEFT)[0]


def test_lateral_view_shows_anterior_at_growing_columns_and_superior_at_small_rows() -> None:
    view = VIEWS["lateral"]
    middle, front, up = view.pixels(view.project([200.0 * UP, 200.0 * UP + FRONT, 201.0 * UP]))
    assert front[0] > middle[0] and up[1] < middle[1]
    # Source at the patient's right: what is on the right is magnified more.
    assert view.project(50.0 * FRONT - 50.0 * LEFT)[0] > view.project(50.0 * FRONT)[0]


def test_magnification_is_that_of_the_patient_plane() -> None:
    view = frontal_view(sid=1500.0, source_to_patient=1340.0, centre=(5.0, 200.0, 10.0))
    assert view.magnification == pytest.approx(1500.0 / 1340.0, abs=1e-15)
    plane = np.array([[5.0, 200.0, 10.0], [35.0, 190.0, 10.0]])
    np.testing.assert_allclose(view.to_patient_plane(view.project(plane)), [[0.0, 0.0], [30.0, 10.0]], atol=1e-12)


@pytest.mark.parametrize("view", [*VIEWS.values(), oblique_view()])
def test_moved_rolls_then_shifts_the_picture_of_the_patient_plane(view: XRayView) -> None:
    q = np.random.default_rng(5).uniform(-200.0, 200.0, (20, 2))
    foot = view.source + view.source_to_patient * view.normal
    plane = foot + q @ view.detector_axes
    shift, roll = np.array([12.0, -5.0]), 0.07
    turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    moved = view.moved(shift, roll)
    np.testing.assert_allclose(moved.to_patient_plane(moved.project(plane)), q @ turn.T + shift, atol=1e-10)
    np.testing.assert_allclose(moved.principal_point, view.principal_point, atol=1e-10)
    assert moved.magnification == pytest.approx(view.magnification, rel=1e-12)


def test_moved_sees_what_the_view_sees_of_a_moved_patient(points: np.ndarray) -> None:
    view = oblique_view()
    shift, roll = np.array([12.0, -5.0]), 0.07
    turn = exp_so3(roll * np.cross(*view.detector_axes))
    patient = view.source + (points - view.source) @ turn.T + shift @ view.detector_axes
    np.testing.assert_allclose(view.moved(shift, roll).project(points), view.project(patient), atol=1e-10)


def test_moved_by_nothing_is_the_same_view(points: np.ndarray) -> None:
    view = oblique_view()
    np.testing.assert_allclose(view.moved().project(points), view.project(points), atol=1e-11)


def test_a_centred_view_looks_through_its_centre() -> None:
    view = placed_view(-LEFT, -UP, FRONT, sid=1800.0, source_to_patient=1600.0, shape=(31, 21), pixel=0.3,
                       centre=(3.0, 150.0, -4.0))  # fmt: skip
    np.testing.assert_allclose(view.pixels(view.project([3.0, 150.0, -4.0])), [10.0, 15.0], atol=1e-10)
    np.testing.assert_allclose(view.pixels(view.principal_point), [10.0, 15.0], atol=1e-10)


def test_a_point_behind_the_source_is_refused() -> None:
    with pytest.raises(RadiographError, match="behind the X-ray source"):
        VIEWS["frontal"].project([[0.0, 200.0, 0.0], [0.0, 200.0, 1341.0]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pixel": 0.0}, "pixel spacing"),
        ({"shape": (0, 4)}, "0 x 4"),
        ({"source_to_patient": 1600.0}, "source to patient"),
        ({"source_to_patient": -1.0}, "source to patient"),
        ({"centre": (0.0, np.nan, 0.0)}, "not finite"),
    ],
)
def test_impossible_geometry_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(RadiographError, match=message):
        frontal_view(**change)  # type: ignore[arg-type]


def test_detector_axes_that_are_not_perpendicular_are_refused() -> None:
    with pytest.raises(RadiographError, match="perpendicular"):
        XRayView(np.array([0, 0, 9.0]), np.zeros(3), np.array([[1.0, 0, 0], [0.6, 0.8, 0]]), np.ones(2), (4, 4), 5.0)
