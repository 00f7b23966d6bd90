"""Features of vertebrae: what they are, that they are the same from corners and from states, their derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.state import TorsoState, retract
from spinestiff.anatomy.torso import JointTable, TissueMesh, TorsoModel
from spinestiff.errors import RadiographError, TrackingError
from spinestiff.imaging import features as ft
from spinestiff.imaging.projection import frontal_view, lateral_view

NAMES = ("T7", "T8", "L3")
# Left-right width, height, depth. L3 is as wide as deep; none is near square in either view.
SIZES = np.array([[30.0, 19.0, 27.0], [31.0, 20.0, 28.0], [45.0, 28.0, 36.0]])
VIEWS = {"frontal": frontal_view(centre=(0, 0, 0)), "lateral": lateral_view(centre=(0, 0, 0))}
SIXTH_ORDER = {1: 45.0 / 60, 2: -9.0 / 60, 3: 1.0 / 60}


def boxes(sizes: np.ndarray) -> np.ndarray:
    signs = np.array([[0, s, 0] for s in (1, -1)])[:, None, None] + np.array([[x, 0, 0] for x in (1, -1)])[:, None]
    signs = signs + np.array([[0, 0, z] for z in (1, -1)])
    return 0.5 * sizes[:, None, :] * signs.reshape(1, 8, 3)


def torso(sizes: np.ndarray = SIZES) -> TorsoModel:
    rng = np.random.default_rng(3)
    positions = np.array([[5.0, 100.0, -20.0], [-8.0, 70.0, 15.0], [3.0, -120.0, 4.0]])
    rest = TorsoState(positions, exp_so3(0.2 * rng.standard_normal((3, 3))), np.empty((0, 3)))
    none, frames = np.empty((0, 3)), np.empty((0, 3, 3))
    joints = JointTable((), (), np.empty(0), np.empty(0), none, frames, none, frames, np.empty((0, 6)))
    tissue = TissueMesh(none, np.empty((0, 4)), np.empty(0), np.empty(0), np.empty(0))
    return TorsoModel(NAMES, rest, joints, tissue, boxes(sizes), (), {}, 160.0, NAMES)


def upright(model: TorsoModel, turn: np.ndarray | float = 0.0, depth: float = 0.0) -> TorsoState:
    """Vertebrae in the patient plane, turned about the antero-posterior axis."""
    positions = model.rest_pose.bone_positions * [1.0, 1.0, 0.0] + [0.0, 0.0, depth]
    w = np.zeros((3, 3))
    w[:, 2] = turn
    return TorsoState(positions, exp_so3(w), np.empty((0, 3)))


def quad(view, centre, angle, width, height):
    """Corners on the detector of a turned rectangle; angle anticlockwise as the patient's left goes up."""
    first, up = ft.picture_axes(view)
    c, s = np.cos(angle), np.sin(angle)
    local = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * 0.5 * [width, height]
    local = local @ np.array([[c, s], [-s, c]])
    return view.from_patient_plane(centre + local @ np.array([first, up]))


@pytest.mark.parametrize("orientation", ft.ORIENTATIONS)
@pytest.mark.parametrize("name", VIEWS)
def test_eq_12_feature_derivatives_by_sixth_order_differences(name: str, orientation: ft.Orientation) -> None:
    model, view = torso(), VIEWS[name]
    shares = ft.silhouette_shares(model, view, model.rest_pose)
    state = retract(model.rest_pose, 0.1 * np.random.default_rng(1).standard_normal(18))
    exact = ft.state_features(model, view, state, shares, orientation).jacobian
    assert np.abs(exact).min(axis=(0, 1)).min() > 1e-6, "a derivative that is zero proves nothing"
    for bone in range(3):
        for dof in range(6):
            dx = np.zeros(18)
            dx[6 * bone + dof] = 1.0
            step, slope = (0.1 if dof < 3 else 1e-3), 0.0
            for k, weight in SIXTH_ORDER.items():
                ahead, behind = (retract(state, s * k * step * dx) for s in (1, -1))
                z = [ft.state_features(model, view, at, shares, orientation).z for at in (ahead, behind)]
                slope += weight * (z[0] - z[1]) / step
            others = [v for v in range(3) if v != bone]
            assert np.abs(slope[others]).max() == 0.0
            scale = np.abs(exact[..., dof]).max()
            assert np.abs(slope[bone] - exact[bone, ..., dof]).max() < 1e-9 * scale


@pytest.mark.parametrize("orientation", ft.ORIENTATIONS)
def test_derivatives_with_a_lost_corner(orientation: ft.Orientation) -> None:
    model, view = torso(), VIEWS["frontal"]
    shares = ft.silhouette_shares(model, view, model.rest_pose)
    used = np.ones((3, 4), dtype=bool)
    used[1, 2] = False
    exact = ft.state_features(model, view, model.rest_pose, shares, orientation, used).jacobian
    for dof in range(6):
        dx = np.zeros(18)
        dx[6 + dof] = 1e-3
        ahead, behind = (retract(model.rest_pose, s * dx) for s in (1, -1))
        z = [ft.state_features(model, view, at, shares, orientation, used).z for at in (ahead, behind)]
        assert np.allclose((z[0] - z[1])[1] / 2e-3, exact[1, ..., dof], atol=1e-5)


@pytest.mark.parametrize("name", VIEWS)
def test_eq_9_upright_box_is_seen_as_itself(name: str) -> None:
    """z of an unturned box in the patient plane is the reference box at the projected centre, in anatomical mm."""
    model, view = torso(), VIEWS[name]
    state = TorsoState(np.zeros((3, 3)), np.broadcast_to(np.eye(3), (3, 3, 3)), np.empty((0, 3)))
    shares = ft.silhouette_shares(model, view, state)
    found = ft.state_features(model, view, state, shares)
    first, up = ft.picture_axes(view)
    assert np.allclose(found.angle, 0.0, atol=1e-12)
    width = SIZES[:, 0] if name == "frontal" else SIZES[:, 2]
    expected = 0.5 * width[:, None] * first + 0.5 * SIZES[:, 1, None] * up
    assert np.allclose(found.z[:, 0], expected, atol=1e-9)
    assert np.allclose(found.z[:, 2], -expected, atol=1e-9)


def test_first_corner_is_left_or_anterior_and_superior_in_every_display() -> None:
    model = torso()
    state = upright(model)
    flips = [view.__class__(view.source, view.detector_origin, view.detector_axes * [[-1.0], [1.0]], view.pixel_spacing,
                            view.shape, view.source_to_patient) for view in VIEWS.values()]  # fmt: skip
    for view in (*VIEWS.values(), *flips, VIEWS["frontal"].moved((3.0, 4.0), 2.0)):
        shares = ft.silhouette_shares(model, view, state)
        seen = ft.state_features(model, view, state, shares).corners
        positions = state.bone_positions
        side = np.array([8.0, 0, 0]) if ft.view_kind(view) == "frontal" else np.array([0, 0, 8.0])
        to_first = view.project(positions + side) - view.project(positions)
        to_top = view.project(positions + np.array([0.0, 8.0, 0.0])) - view.project(positions)
        assert (np.einsum("vi,vi->v", seen[:, 0] - seen[:, 1], to_first) > 0).all()
        assert (np.einsum("vi,vi->v", seen[:, 3] - seen[:, 2], to_first) > 0).all()
        assert (np.einsum("vi,vi->v", seen[:, 0] - seen[:, 3], to_top) > 0).all()


@pytest.mark.parametrize("orientation", ft.ORIENTATIONS)
@pytest.mark.parametrize("name", VIEWS)
def test_targets_of_simulated_corners_are_the_simulated_features(name: str, orientation: ft.Orientation) -> None:
    model, view = torso(), VIEWS[name]
    shares = ft.silhouette_shares(model, view, model.rest_pose)
    found = ft.state_features(model, view, model.rest_pose, shares, orientation)
    order = (2, 0)
    corners = ft.VertebraCorners(tuple(NAMES[i] for i in order), found.corners[list(order)])
    target = ft.target_features(model, view, corners, orientation)
    assert np.abs(target - found.z[list(order)]).max() < 1e-11


def test_the_silhouette_goes_to_the_outer_edge_of_a_tilted_plate() -> None:
    """Tipped forward, the plates' hind edges are the upper ones: corners lie behind above, in front below."""
    model, view = torso(), VIEWS["frontal"]
    tipped = upright(model)
    # On the principal ray, so that the plates are seen edge on as long as they are not tipped.
    still = TorsoState(np.zeros((3, 3)), np.broadcast_to(np.eye(3), (3, 3, 3)), np.empty((0, 3)))
    forward = TorsoState(tipped.bone_positions, exp_so3(np.tile([0.4, 0, 0], (3, 1))), np.empty((0, 3)))
    backward = TorsoState(tipped.bone_positions, exp_so3(np.tile([-0.4, 0, 0], (3, 1))), np.empty((0, 3)))
    assert np.abs(ft.silhouette_shares(model, view, still)).max() < 0.06
    signs = np.array([-1.0, -1.0, 1.0, 1.0])
    assert (signs * ft.silhouette_shares(model, view, forward) > 0.3).all()
    assert (-signs * ft.silhouette_shares(model, view, backward) > 0.3).all()


def test_a_turn_about_the_vertical_shifts_box_corners_and_not_the_silhouette() -> None:
    """A round body that turns by 4 degrees keeps its outline; its box's corners move by half a depth times that."""
    model, view = torso(), VIEWS["frontal"]
    still = TorsoState(np.zeros((3, 3)), np.broadcast_to(np.eye(3), (3, 3, 3)), np.empty((0, 3)))
    turned = TorsoState(still.bone_positions, exp_so3(np.tile([0, 0.07, 0], (3, 1))), np.empty((0, 3)))
    shares = ft.silhouette_shares(model, view, still)

    def shifts(of: np.ndarray) -> np.ndarray:
        before, after = (ft.state_features(model, view, state, of).corners for state in (still, turned))
        return np.linalg.norm(after - before, axis=-1) / view.magnification

    assert shifts(np.ones((3, 4))) == pytest.approx(np.tile(0.5 * 0.07 * SIZES[:, 2, None], (1, 4)), rel=0.1)
    assert shifts(shares).max() < 0.15


@pytest.mark.parametrize("orientation", ft.ORIENTATIONS)
def test_orientation_is_continuous_through_a_full_turn(orientation: ft.Orientation) -> None:
    view = VIEWS["frontal"]
    angles = np.deg2rad(np.arange(0.0, 360.0, 0.1))
    reference = np.repeat(ft.reference_boxes(torso(), view)[:1], len(angles), 0)
    seen = view.to_patient_plane(np.stack([quad(view, np.zeros(2), a, 30.0, 19.0) for a in angles]))
    placed = ft.place_boxes(seen, reference, orientation)
    assert np.abs(placed.z - seen).max() < 1e-9
    jump = np.diff(np.append(placed.z, placed.z[:1], 0), axis=0)
    assert np.linalg.norm(jump, axis=-1).max() < np.deg2rad(0.1) * np.hypot(15.0, 9.5) * 1.001


@pytest.mark.parametrize("orientation", ft.ORIENTATIONS)
def test_features_move_with_the_picture(orientation: ft.Orientation) -> None:
    """Equivariance: shifting and turning the seen corners shifts and turns the placed box, whatever their shape."""
    rng = np.random.default_rng(0)
    reference = ft.reference_boxes(torso(), VIEWS["frontal"])
    seen = reference + rng.standard_normal(reference.shape)
    turn, shift = 0.7, np.array([11.0, -4.0])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    one = ft.place_boxes(seen, reference, orientation)
    two = ft.place_boxes(seen @ rotation.T + shift, reference, orientation)
    assert np.abs(two.z - (one.z @ rotation.T + shift)).max() < 1e-12
    assert np.abs(one.z - seen).max() > 0.1


def test_procrustes_is_the_best_turn() -> None:
    rng = np.random.default_rng(5)
    reference = ft.reference_boxes(torso(), VIEWS["frontal"])
    seen = reference + 2.0 * rng.standard_normal(reference.shape)
    best = ft.place_boxes(seen, reference, "procrustes")
    misfit = np.sum((best.z - seen) ** 2, axis=(1, 2))
    for turn in (-1e-3, 1e-3):
        c, s = np.cos(turn), np.sin(turn)
        arm = best.z - best.centre[:, None]
        turned = best.centre[:, None] + arm @ np.array([[c, s], [-s, c]])
        assert (np.sum((turned - seen) ** 2, axis=(1, 2)) > misfit).all()


def test_covariance_amplifies_noise_as_predicted() -> None:
    """First order: (w^2 + h^2) / (w^2 - h^2) times Procrustes' angle noise."""
    reference = np.repeat(ft.reference_boxes(torso(), VIEWS["frontal"])[:1], 4000, 0)
    seen = reference + 0.05 * np.random.default_rng(2).standard_normal(reference.shape)
    spread = [ft.place_boxes(seen, reference, o).angle.std() for o in ft.ORIENTATIONS]
    w2, h2 = 30.0**2, 19.0**2
    assert spread[1] / spread[0] == pytest.approx((w2 + h2) / (w2 - h2), rel=0.05)
    assert spread[0] == pytest.approx(0.05 / np.sqrt(w2 + h2), rel=0.05)


def test_near_square_boxes_are_flagged_and_finite_under_covariance() -> None:
    model = torso(np.array([[26.0, 24.0, 30.0], [31.0, 20.0, 28.0], [45.0, 28.0, 30.0]]))
    for name, expected in (("frontal", [True, False, False]), ("lateral", [False, False, True])):
        view = VIEWS[name]
        shares = ft.silhouette_shares(model, view, model.rest_pose)
        found = ft.state_features(model, view, model.rest_pose, shares, "covariance")
        assert ft.near_square(ft.reference_boxes(model, view)).tolist() == expected
        assert np.isfinite(found.jacobian).all()


def test_an_exact_square_stays_finite_under_covariance() -> None:
    square = np.array([[[10.0, 10], [-10, 10], [-10, -10], [10, -10]]])
    placed = ft.place_boxes(square, square, "covariance")
    assert np.isfinite(placed.z).all()
    assert np.isfinite(placed.angle_gradient).all()


def test_a_lost_corner_does_not_shift_the_box() -> None:
    model, view = torso(), VIEWS["frontal"]
    shares = ft.silhouette_shares(model, view, model.rest_pose)
    seen = ft.state_features(model, view, model.rest_pose, shares).corners.copy()
    quality = np.ones((3, 4))
    quality[1, 3] = 0.0
    seen[1, 3] += 40.0
    corners = ft.VertebraCorners(NAMES, seen, quality)
    same = ft.state_features(model, view, model.rest_pose, shares, used=corners.usable).z
    assert np.abs(ft.target_features(model, view, corners) - same).max() < 1e-11


def test_bad_corners_are_named() -> None:
    model, view = torso(), VIEWS["frontal"]
    good = np.stack([quad(view, np.array([0.0, 30.0 * i]), 0.1, *SIZES[i, :2]) for i in range(3)])

    def seen(change) -> None:
        corners = good.copy()
        corners[1] = change(corners[1])
        ft.target_features(model, view, ft.VertebraCorners(NAMES, corners))

    seen(lambda q: q)
    for change, text in (
        (lambda q: q[[1, 0, 3, 2]], "T8 are mirrored, crossed"),
        (lambda q: q[[2, 3, 0, 1]], "T8 .*upside down"),
        (lambda q: q[[0, 1, 3, 2]], "T8 are mirrored, crossed"),
        (lambda q: q * 7.0, "T8 .*times its size"),
        (lambda q: q * 0.0, "T8 .*times its size"),
    ):
        with pytest.raises(TrackingError, match=text):
            seen(change)
    quality = np.ones((3, 4))
    quality[2, :2] = 0.0
    with pytest.raises(TrackingError, match="L3 has 2 usable corners"):
        ft.target_features(model, view, ft.VertebraCorners(NAMES, good, quality))
    with pytest.raises(TrackingError, match="no such vertebra"):
        ft.target_features(model, view, ft.VertebraCorners(("T1",), good[:1]))


@pytest.mark.parametrize(
    ("names", "corners", "quality", "text"),
    [
        (("T13",), np.zeros((1, 4, 2)), None, "T13"),
        (("T7", "T7"), np.zeros((2, 4, 2)), None, "T7 are given more than once"),
        (("T7",), np.zeros((1, 3, 2)), None, "shape"),
        (("T7",), np.full((1, 4, 2), np.nan), None, "not finite"),
        (("T7",), np.zeros((1, 4, 2)), np.full((1, 4), 1.5), "quality"),
    ],
)
def test_impossible_corners_are_refused(names, corners, quality, text: str) -> None:
    with pytest.raises(TrackingError, match=text):
        ft.VertebraCorners(names, corners, quality)


def test_views_from_above_and_unknown_orientations_are_refused() -> None:
    model, view = torso(), VIEWS["frontal"]
    above = view.__class__([0, 900.0, 0], [0, -200.0, 0], [[1.0, 0, 0], [0, 0, 1.0]], [1, 1], (10, 10), 900.0)
    with pytest.raises(RadiographError, match="up or down"):
        ft.view_kind(above)
    shares = ft.silhouette_shares(model, view, model.rest_pose)
    with pytest.raises(RadiographError, match="procrustes, covariance"):
        ft.state_features(model, view, model.rest_pose, shares, "svd")  # type: ignore[arg-type]


def test_selected_keeps_order_and_quality() -> None:
    quality = np.array([[0.1] * 4, [0.2] * 4])
    corners = ft.VertebraCorners(("T7", "T8"), np.arange(16.0).reshape(2, 4, 2), quality)
    chosen = corners.selected(("L1", "T8", "T7"))
    assert chosen.vertebrae == ("T8", "T7")
    assert chosen.quality[0, 0] == 0.2
    assert chosen.corners[1, 0, 0] == 0.0
