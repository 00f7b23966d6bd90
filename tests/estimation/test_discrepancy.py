"""estimation/discrepancy.py: columns of the covariance of truth - model, and the data they come from."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from spinestiff.anatomy.template import template_torso
from spinestiff.errors import FitError
from spinestiff.estimation.discrepancy import (
    MIRROR,
    DiscrepancyFrame,
    DiscrepancyModes,
    as_corners,
    discrepancy_columns,
    motion_size,
    plane_motion,
)
from spinestiff.estimation.discrepancy_data import (
    EXPECTED,
    DiscrepancyData,
    KindModes,
    geometry_modes,
    read_data,
    shipped_data,
    shipped_modes,
    write_data,
)
from spinestiff.imaging.projection import frontal_view

RANDOM = np.random.default_rng(5)
MOTION = RANDOM.normal(0.0, [5.0, 1.0, 0.05], (17, 3))
OTHER = {"left": "right", "right": "left"}


SHAPE = (2, 2, 17, 3)
LEVELS = np.array([5.0, 9.0])


def some_modes(own_share: float = 0.0, remainder: float = 0.02, modes=None) -> DiscrepancyModes:
    drawn = np.random.default_rng(1).normal(0.0, 0.05, (3, *SHAPE)) if modes is None else modes
    return DiscrepancyModes(LEVELS, drawn, np.full(SHAPE, remainder), own_share)


def some_kind(seed: int = 1, **changed) -> KindModes:
    drawn = np.random.default_rng(seed).normal(0.0, 0.05, (3, *SHAPE))
    given = {"pairs": 20, "modes": drawn, "remainder": np.full(SHAPE, 0.02), "own_share": 0.25}
    return KindModes(**{**given, **changed})


def some_data(**changed) -> DiscrepancyData:
    kinds = {"layers": some_kind(1), "volume": some_kind(2)}
    return DiscrepancyData(**{"levels": LEVELS, "kinds": kinds, "inflation": 2.0, "untried": 0.3, **changed})


def covariance(frames, modes) -> np.ndarray:
    columns = discrepancy_columns(frames, modes)
    columns = columns.reshape(len(frames) * 51, -1)
    return columns @ columns.T


def frames_of(*sites, motion=MOTION) -> list[DiscrepancyFrame]:
    return [DiscrepancyFrame(side, level, motion) for side, level in sites]


@pytest.mark.parametrize("mesh", ["coarse", "fine"])
def test_a_mirrored_push_has_the_mirrored_covariance(mesh) -> None:
    modes, sites = shipped_modes(mesh), [("right", 8.0), ("left", 5.0), ("right", 10.5)]
    here = covariance(frames_of(*sites), modes)
    there = covariance(frames_of(*((OTHER[side], level) for side, level in sites), motion=MOTION * MIRROR), modes)
    sign = np.tile(MIRROR, 3 * 17)
    # The data are stored in single precision.
    np.testing.assert_allclose(there, sign[:, None] * here * sign, atol=1e-5 * here.max())


@pytest.mark.parametrize("mesh", ["coarse", "fine"])
def test_the_shipped_covariance_trusts_no_direction(mesh) -> None:
    found = covariance(frames_of(("right", 8.0), ("right", 5.0), ("left", 10.0)), shipped_modes(mesh))
    scale = np.sqrt(np.diag(found))
    least = np.linalg.eigvalsh(found / np.outer(scale, scale)).min()
    assert least > 1e-6


def test_it_grows_with_the_square_of_the_motion() -> None:
    modes = shipped_modes("coarse")
    once, twice = (covariance(frames_of(("right", 8.0), motion=k * MOTION), modes) for k in (1.0, 2.0))
    np.testing.assert_allclose(twice, 4.0 * once)


def test_frames_of_one_push_differ_in_proportion_to_their_motion_and_by_their_own_part() -> None:
    pair = [DiscrepancyFrame("right", 7.0, MOTION), DiscrepancyFrame("right", 7.0, 0.5 * MOTION)]
    found = covariance(pair, some_modes())
    np.testing.assert_allclose(found[51:, 51:], 0.25 * found[:51, :51], atol=1e-12)
    np.testing.assert_allclose(found[:51, 51:], 0.5 * found[:51, :51], atol=1e-12)
    own = covariance(pair, some_modes(own_share=0.2, remainder=0.0))
    np.testing.assert_allclose(own[:51, 51:], 0.8 * 0.5 * own[:51, :51], atol=1e-12)


def test_a_learnt_site_has_its_own_modes_and_a_site_between_two_the_mean() -> None:
    modes = some_modes(remainder=0.0)
    at, between, beyond = (
        discrepancy_columns(frames_of(("right", level)), modes)[0] * [[[1.0], [1.0], [20.0]]] / motion_size(MOTION)
        for level in (9.0, 7.0, 12.0)
    )
    own = np.moveaxis(modes.modes[:, 1], 0, -1)
    np.testing.assert_allclose(at[..., :3], own[1])
    np.testing.assert_allclose(between[..., :3], 0.5 * (own[0] + own[1]))
    np.testing.assert_allclose(beyond[..., :3], own[1])


def test_independent_parts_keep_their_variance_between_two_sites() -> None:
    modes = some_modes(modes=np.zeros((0, *SHAPE)))
    variance = [np.diag(covariance(frames_of(("left", level)), modes)) for level in (5.0, 6.0, 7.0)]
    np.testing.assert_allclose(variance[1], variance[0])
    np.testing.assert_allclose(variance[2], variance[0])


def test_no_frames_no_rows() -> None:
    assert discrepancy_columns([], some_modes()).shape[0] == 0


def test_motion_and_corners_agree_and_left_up_and_left_to_up_are_positive() -> None:
    view = frontal_view()
    corner = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]) * [20.0, 12.0]
    boxes = as_corners(np.zeros((17, 3)), np.zeros((17, 4, 2)), view) + RANDOM.normal(0.0, 1.0, (17, 4, 2)) + corner
    small = 1e-4 * RANDOM.normal(size=(17, 3)) * [1.0, 1.0, 0.05]
    np.testing.assert_allclose(plane_motion(boxes, boxes + as_corners(small, boxes, view), view), small, atol=1e-9)
    left, up = (view.project(np.array(point)) for point in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    centre = view.project(np.zeros(3))
    moved = as_corners(np.tile([1.0, 0.0, 0.0], (17, 1)), boxes, view)[0, 0]
    assert moved @ (left - centre) > 0.9 * np.linalg.norm(left - centre)
    # A turn from left towards up lifts what lies to the left.
    arms = boxes - boxes.mean(axis=1, keepdims=True)
    lifted = as_corners(np.tile([0.0, 0.0, 1.0], (17, 1)), boxes, view)
    assert (np.sign(lifted @ (up - centre)) == np.sign(arms @ (left - centre))).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"side": "front"}, "push side 'front'"),
        ({"level": 12.5}, "push level 12.5"),
        ({"level": float("nan")}, "push level nan"),
        ({"motion": MOTION[:16]}, r"shape \(16, 3\), wanted \(17, 3\)"),
        ({"motion": np.full((17, 3), np.nan)}, "not finite"),
    ],
)
def test_a_frame_that_is_none_is_refused(change, words) -> None:
    with pytest.raises(FitError, match=words):
        DiscrepancyFrame(**{"side": "right", "level": 8.0, "motion": MOTION, **change})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"remainder": np.full(SHAPE, -1.0)}, "a remainder is negative"),
        ({"modes": np.full((1, *SHAPE), 1e3)}, "entry above 100"),
        ({"own_share": 1.5}, "own share 1.5"),
        ({"modes": np.zeros((1, 2, 3, 17, 3))}, "wanted"),
    ],
)
def test_a_kind_that_cannot_be_is_refused(change, words) -> None:
    with pytest.raises(FitError, match=words):
        some_kind(**change)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"levels": np.array([9.0, 5.0])}, "rising rib numbers"),
        ({"levels": np.array([5.0, 13.0])}, "rising rib numbers"),
        ({"levels": np.array([5.0, 7.0, 9.0])}, "'layers' has 2 sites a side, wanted 3"),
        ({"inflation": -1.0}, "inflation -1; wanted 0 to 100"),
        ({"untried": float("nan")}, "untried nan"),
    ],
)
def test_data_that_cannot_be_are_refused(change, words) -> None:
    with pytest.raises(FitError, match=words):
        some_data(**change)


def test_kinds_add_up_by_their_shares_and_untried_shapes_come_on_top() -> None:
    none = np.zeros(SHAPE)
    kinds = {"layers": some_kind(1, remainder=none), "volume": some_kind(2, remainder=none, own_share=0.75)}
    data = some_data(kinds=kinds)
    found = data.combined({"layers": 1.0, "volume": 0.25})
    flat = found.modes.reshape(len(found.modes), -1)
    whole = flat.T @ flat + np.diag(found.remainder.ravel() ** 2)
    layers, volume = data.kinds["layers"].moment, 0.25 * data.kinds["volume"].moment
    both = 2.0 * (layers + volume)
    np.testing.assert_allclose(np.diag(whole), 1.3 * np.diag(both))
    np.testing.assert_allclose(whole - np.diag(np.diag(whole)), both - np.diag(np.diag(both)), atol=1e-12)
    sizes = np.trace(layers), np.trace(volume)
    assert found.own_share == pytest.approx((0.25 * sizes[0] + 0.75 * sizes[1]) / sum(sizes))


def test_an_unknown_kind_and_no_kind_are_refused() -> None:
    with pytest.raises(FitError, match="no discrepancy of the kind 'weather'; known are layers, volume"):
        some_data().combined({"layers": 1.0, "weather": 0.5})
    with pytest.raises(FitError, match="name one at least"):
        some_data().combined({})
    with pytest.raises(FitError, match="unknown tissue mesh 'medium'; known are coarse, fine"):
        shipped_modes("medium")


@pytest.mark.parametrize("mesh", ["coarse", "fine"])
def test_everybody_has_a_body_and_differs_from_a_mesh(mesh) -> None:
    shares, data = EXPECTED[mesh], shipped_data()
    assert shares["body"] == 1.0
    assert [share for kind, share in shares.items() if "mesh" in kind] == [1.0]
    motion = frames_of(("right", 8.0), ("left", 5.0))
    whole = covariance(motion, shipped_modes(mesh))
    for kind in ("body", "stiffening"):
        without = data.combined({name: share for name, share in shares.items() if name != kind})
        assert np.trace(covariance(motion, without)) < np.trace(whole)


def test_a_geometry_from_worse_corners_moves_otherwise_in_proportion() -> None:
    torso = template_torso(157, "coarse")
    half, whole = (geometry_modes(torso, mm) for mm in (0.25, 0.5))
    alone = shipped_data().combined({"geometry": 1.0})
    assert np.allclose(whole.modes, alone.modes) and np.allclose(whole.remainder, alone.remainder)
    assert np.allclose(half.modes, 0.5 * alone.modes) and np.allclose(half.remainder, 0.5 * alone.remainder)
    # It is a part of what is expected.
    frames = [DiscrepancyFrame("left", 8.0, MOTION)]
    own, every = (discrepancy_columns(frames, modes).reshape(51, -1) for modes in (whole, shipped_modes("coarse")))
    share = np.trace(own @ own.T) / np.trace(every @ every.T)
    assert 0.01 < share < 1.0
    assert geometry_modes(SimpleNamespace(vertebrae=("B1", "B2")), 0.5) is None


def test_the_shipped_data_are_small_and_from_enough_pairs() -> None:
    data = shipped_data()
    assert sum(kind.pairs for kind in data.kinds.values()) >= 200
    assert data.made


@pytest.fixture
def stored(tmp_path):
    path = tmp_path / "discrepancy.npz"
    write_data(path, some_data(made="a day"))
    return path


def test_what_is_written_is_read(stored, tmp_path) -> None:
    found, given = read_data(stored), some_data(made="a day")
    assert (found.made, found.inflation, found.untried, list(found.kinds)) == ("a day", 2.0, 0.3, list(given.kinds))
    for name, kind in given.kinds.items():
        assert (found.kinds[name].pairs, found.kinds[name].own_share) == (20, 0.25)
        np.testing.assert_allclose(found.kinds[name].moment, kind.moment, atol=1e-8)
    again = tmp_path / "again.npz"
    write_data(again, given)
    assert again.read_bytes() == stored.read_bytes()


class Pickled:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, path) -> None:
        self.path = str(path)

    def __reduce__(self):
        return open, (self.path, "w")


def _damaged(path, damage) -> None:
    content = path.read_bytes()
    if damage == "cut short":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "text":
        path.write_text("modes\n")
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "a byte":
        path.write_bytes(content[:300] + bytes([content[300] ^ 0xFF]) + content[301:])
    elif damage == "an array":
        np.save(path.with_suffix(".npy"), np.zeros(3))
        path.write_bytes(path.with_suffix(".npy").read_bytes())
    else:
        with np.load(path) as file:
            arrays = {key: file[key] for key in file.files}
        if damage == "no modes":
            del arrays["modes_0"]
        elif damage == "not finite":
            arrays["modes_0"][0, 0, 0, 0, 0] = np.nan
        elif damage == "pickled":
            arrays["modes_0"] = np.array([Pickled(path.with_name("unpickled"))], dtype=object)
        elif damage == "words for numbers":
            arrays["modes_0"] = np.array(["a"])
        elif damage == "other schema":
            arrays["header"] = np.array('{"schema": "spinestiff-torso", "schema_version": 1}')
        elif damage == "no header":
            del arrays["header"]
        elif damage == "a list for a header":
            arrays["header"] = np.array("[]")
        np.savez(path, **arrays)


@pytest.mark.parametrize(
    "damage",
    ["cut short", "text", "empty", "a byte", "an array", "no modes", "not finite", "pickled", "words for numbers",
     "other schema", "no header", "a list for a header"],
)  # fmt: skip
def test_damaged_data_end_in_one_line(stored, damage) -> None:
    _damaged(stored, damage)
    with pytest.raises(FitError) as caught:
        read_data(stored)
    line = str(caught.value)
    assert str(stored) in line and "install spinestiff anew" in line and "\n" not in line
    assert not stored.with_name("unpickled").exists()


def test_a_missing_file_is_named(tmp_path) -> None:
    with pytest.raises(FitError, match="nowhere"):
        read_data(tmp_path / "nowhere.npz")
