"""Tracking on pictures made here: textured vertebrae that move as known bodies through shading, ribs and noise."""

from __future__ import annotations

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.errors import TrackingError
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.imaging.tracking import SUPPORT_LIMIT_MM, support_motion, track
from spinestiff.imaging.tracking.following import Place, credits, likeliest_places
from spinestiff.imaging.tracking.patches import Body
from spinestiff.imaging.tracking.pictures import Pictures, levels
from spinestiff.imaging.tracking.quality import FOUND, error_of, quality_of
from spinestiff.imaging.tracking.registration import Patch, likeness_of_walls, settled_at
from spinestiff.imaging.tracking.supports import FLESH_MM, _middle, _turn

SHAPE = (620, 360)
VIEW = frontal_view(shape=SHAPE, pixel=0.7)
PLANE_MM = float(VIEW.pixel_spacing[0] / VIEW.magnification)
WIDTH, HEIGHT, PITCH = 46.0, 26.0, 34.0


def radiograph(pixels, view=VIEW):
    return Radiograph(pixels, view)


def rest_poses(count=16):
    """(n, 3) angle and centre in pixels of the vertebrae of a slightly curved spine."""
    y = 50.0 + PITCH * np.arange(count)
    return np.column_stack([0.1 * np.cos(y / 90.0), 180.0 + 9.0 * np.sin(y / 90.0), y])


def pushed_poses(poses, pixels):
    """The spine bent sideways by up to ``pixels``, vertebrae turned along."""
    height = (poses[:, 2] - 50.0) / 520.0
    bend = np.sin(np.pi * height)
    slope = pixels * np.pi / 520.0 * np.cos(np.pi * height)
    return poses + np.column_stack([-slope, pixels * bend, 0.05 * pixels * (1.0 - 2.0 * height)])


def quads(poses):
    """Corners (n, 4, 2): the patient's left at growing columns."""
    flat = 0.5 * np.array([[WIDTH, -HEIGHT], [-WIDTH, -HEIGHT], [-WIDTH, HEIGHT], [WIDTH, HEIGHT]])
    cosine, sine = np.cos(poses[:, 0]), np.sin(poses[:, 0])
    turn = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], -2)
    return np.einsum("nij,kj->nki", turn, flat) + poses[:, None, 1:]


def picture(poses, seed=0, gain=1.0, offset=0.0, noise=2.0, ribs_move=0.0):
    """A radiograph-like picture: shading, oblique ribs, vertebrae with rims and texture of their own, noise."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    image = 60.0 + 40.0 * np.exp(-(((column - 180.0) / 110.0) ** 2))
    image += 12.0 * (np.sin((row + 0.35 * np.abs(column - 180.0 - ribs_move)) / 6.5) > 0.45)
    grain = np.random.default_rng(7).standard_normal((len(poses), 60, 80))
    for (angle, x, y), texture in zip(poses, grain):
        near = (slice(max(0, int(y) - 40), int(y) + 41), slice(max(0, int(x) - 50), int(x) + 51))
        du, dv = column[near] - x, row[near] - y
        u = np.cos(angle) * du + np.sin(angle) * dv
        v = -np.sin(angle) * du + np.cos(angle) * dv
        outside = np.maximum(np.abs(u) - WIDTH / 2, np.abs(v) - HEIGHT / 2)
        inside = 1.0 / (1.0 + np.exp(np.clip(outside * 3.0, -50, 50)))
        rim = np.exp(-((outside + 1.5) ** 2) / 3.0)
        smooth = gaussian_filter(texture, 2.5) * 30.0
        image[near] += (
            inside * (35.0 + map_coordinates(smooth, [v + 30.0, u + 40.0], order=1, mode="nearest")) + 18.0 * rim
        )
    image = gaussian_filter(image, 0.6) * gain + offset
    return (image + noise * np.random.default_rng(seed).standard_normal(SHAPE)).astype(np.float32)


def sequence(largest, count=4, **changes):
    """Frames under a growing push with exposure changes, and true corners (F, n, 4, 2) pixels."""
    poses = [pushed_poses(rest_poses(), largest * k / (count - 1)) for k in range(count)]
    gains = 1.0 + 0.25 * np.sin(np.arange(count))
    frames = [
        radiograph(picture(pose, seed=k, gain=gain, offset=8.0 * k, ribs_move=0.6 * largest * k / count, **changes))
        for k, (pose, gain) in enumerate(zip(poses, gains))
    ]
    return frames, np.stack([quads(pose) for pose in poses])


def corners(pixels, view=VIEW):
    return VertebraCorners(VERTEBRAE[: len(pixels)], view.from_pixels(pixels))


def errors_mm(tracked, truth):
    """(F, n, 4) mm at the patient plane."""
    found = np.stack([VIEW.pixels(frame.corners) for frame in tracked])
    return np.linalg.norm(found - truth, axis=-1) * PLANE_MM


@pytest.mark.parametrize("largest", [0.0, 6.0, 30.0, 90.0])
def test_corners_follow_a_bending_spine(largest):
    frames, truth = sequence(largest)
    first = corners(truth[0])
    tracked = track(frames, {0: first})
    error = errors_mm(tracked, truth)
    assert tracked[0] is first
    assert np.median(error[1:]) <= 0.15
    assert np.percentile(error[1:], 95) <= 0.5
    assert np.median([frame.quality for frame in tracked[1:]]) > 0.5


def test_a_vertebra_that_flow_lost_is_found_beside_its_neighbour():
    """Two pitches in one step: flow alone takes some vertebrae for others, by 8 mm and more."""
    frames, truth = sequence(70.0, count=2)
    assert errors_mm(track(frames, {0: corners(truth[0])}), truth).max() < 0.5


def test_the_order_in_which_vertebrae_are_marked_changes_nothing():
    frames, truth = sequence(70.0, count=2)
    order = np.random.default_rng(1).permutation(len(truth[0]))
    mixed = VertebraCorners(tuple(VERTEBRAE[i] for i in order), VIEW.from_pixels(truth[0][order]))
    tracked = track(frames, {0: mixed})
    assert tracked[1].vertebrae == VERTEBRAE[: len(order)]
    assert errors_mm(tracked, truth).max() < 0.5


@pytest.mark.parametrize("lag", [-4.0, 4.0])
def test_arches_brighter_than_the_walls_do_not_take_vertebrae_along(lag):
    """Those of two vertebrae side by side lie 2 mm off, as where vertebrae turn about their own axis: the patches look
    more alike there than where the walls are, but the discs above and below would have sheared."""
    rest = rest_poses()
    pushed = pushed_poses(rest, 25.0)

    def frame(poses, aside, seed):
        image = picture(poses, seed=seed)
        row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
        for angle, x, y in poses[[6, 7]]:
            u = np.cos(angle) * (column - x) + np.sin(angle) * (row - y) - aside
            v = -np.sin(angle) * (column - x) + np.cos(angle) * (row - y)
            posts = np.exp(-((np.abs(u) - WIDTH / 2) ** 2) / 2.0) * (np.abs(v) < 0.22 * HEIGHT)
            image += (70.0 * posts).astype(np.float32)
        return radiograph(image)

    truth = np.stack([quads(rest), quads(pushed)])
    frames = [frame(rest, 0.0, 0), frame(pushed, lag, 1)]
    assert errors_mm(track(frames, {0: corners(truth[0])}), truth).max() < 0.5


def test_what_crosses_the_endplates_does_not_tell_how_alike_the_walls_are():
    """Processes over both endplates, 2 pixels aside of where they were before the body."""
    rest = rest_poses()
    angle, x, y = rest[6]
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)

    def frame(aside, seed):
        u = np.cos(angle) * (column - x) + np.sin(angle) * (row - y) - aside
        v = -np.sin(angle) * (column - x) + np.cos(angle) * (row - y)
        process = (np.abs(u) < 0.1 * WIDTH) * (np.abs(np.abs(v) - 0.5 * HEIGHT) < 0.3 * HEIGHT)
        return radiograph(picture(rest, seed=seed) + (90.0 * process).astype(np.float32))

    def alike(aside):
        pictures = Pictures.of([frame(0.0, 0), frame(aside, 1)])
        body = Body.of_vertebra(pictures.binned(corners(quads(rest)).corners)[6])
        before, now = (levels(image, pictures.mm) for image in pictures.images)
        patch, there = Patch.of(body, before), np.zeros(3)
        return settled_at(body, patch, now, there)[1], likeness_of_walls(body, patch, now, there)

    (whole, walls), (whole_aside, walls_aside) = alike(0.0), alike(2.0)
    assert whole_aside < whole - 0.1
    assert walls_aside == pytest.approx(walls, abs=0.02)


def test_of_two_places_beside_each_other_that_is_taken_where_the_walls_are_alike():
    body = Body.of_vertebra(quads(rest_poses())[6])
    aside = Place(np.array([0.0, 2.0, 0.0]), likeness=0.8, of_walls=0.6)
    true = Place(np.zeros(3), likeness=0.7, of_walls=0.8)
    (found,) = likeliest_places([body], [[aside, true]])
    assert found is true


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("marked", [[0], [0, 5, 6], [0, 1, 1, 2]])
def test_single_vertebrae_gaps_and_one_marked_twice_are_followed(marked):
    frames, truth = sequence(12.0, count=2)
    found = track(frames, {0: corners(truth[0][marked])})
    assert errors_mm(found, truth[:, marked]).max() < 0.3


def test_a_picture_stored_twice_shows_its_corners_at_the_same_places():
    """By which an estimate finds it (``study.judgement.forces.copies``)."""
    frames, truth = sequence(8.0, 3)
    found = track([frames[0], frames[1], frames[1], frames[2]], {0: corners(truth[0])})
    assert np.abs(found[1].corners - found[2].corners).max() < 1e-4
    assert np.abs(found[2].corners - found[3].corners).max() > 0.1


def test_errors_do_not_add_up():
    """Eleven frames there and back: each is registered on the first one."""
    poses = [pushed_poses(rest_poses(10), 12.0 * min(k, 10 - k)) for k in range(11)]
    frames = [radiograph(picture(pose, seed=k, ribs_move=5.0 * min(k, 10 - k))) for k, pose in enumerate(poses)]
    truth = np.stack([quads(pose) for pose in poses])
    error = errors_mm(track(frames, {0: corners(truth[0])}), truth)
    assert np.percentile(error[-1], 95) <= 0.1
    assert np.percentile(error, 95) <= 0.3


def test_a_spoilt_frame_is_lost_and_spoils_no_other():
    frames, truth = sequence(75.0, count=5)
    frames[2] = radiograph(np.full(SHAPE, 80.0, dtype=np.float32))
    tracked = track(frames, {0: corners(truth[0])})
    assert not tracked[2].usable.any()
    error = errors_mm(tracked, truth)
    assert np.percentile(error[[1, 3, 4]], 95) <= 0.5
    assert np.median(tracked[4].quality) > 0.3


def test_quality_tells_a_vertebra_that_vanished():
    """Forward and backward flow agree on the empty place; only the likeness tells."""
    frames, truth = sequence(12.0, count=3)
    hidden = [pushed_poses(rest_poses(), 6.0 * k) for k in range(3)]
    row, column = (round(float(x)) for x in hidden[2][7, :0:-1])
    gone = frames[2].pixels.copy()
    patch = gone[row - 20 : row + 20, column - 32 : column + 32]
    patch[:] = gaussian_filter(patch, 12.0) + np.random.default_rng(3).normal(0.0, 2.0, patch.shape)
    frames[2] = radiograph(gone)
    quality = track(frames, {0: corners(truth[0])})[2].quality
    assert quality[7].max() < 0.3
    assert np.median(np.delete(quality, 7, axis=0)) > 0.6


def test_what_leaves_the_image_is_lost():
    poses = [rest_poses() + [0.0, 0.0, 27.0 + 10.0 * k] for k in range(6)]
    truth = np.stack([quads(pose) for pose in poses])
    tracked = track([radiograph(picture(pose, seed=k)) for k, pose in enumerate(poses)], {0: corners(truth[0])})
    outside = truth[..., 1] > SHAPE[0]
    assert outside[2, -1].any()
    assert not outside[2, -1].all()
    assert outside[5, -1].all()
    for frame, gone in zip(tracked, outside):
        assert not frame.usable[gone].any()
        assert frame.usable[:15].all()
    assert np.percentile(errors_mm(tracked, truth)[:, :15], 95) < 0.5


def test_a_quality_given_at_the_start_is_kept():
    frames, truth = sequence(6.0, count=2)
    quality = np.ones((16, 4))
    quality[3, 1] = 0.0
    given = VertebraCorners(VERTEBRAE[:16], VIEW.from_pixels(truth[0]), quality)
    assert track(frames, {0: given})[1].quality[3, 1] == 0.0


def test_fine_pixels_are_binned_and_corners_stay_in_their_own():
    frames, truth = sequence(18.0, count=2)
    fine_view = frontal_view(shape=(3 * SHAPE[0], 3 * SHAPE[1]), pixel=0.7 / 6.0)
    fine = [radiograph(np.kron(frame.pixels, np.ones((3, 3), np.float32)), fine_view) for frame in frames]
    tracked = track(fine, {0: corners(3.0 * truth[0] + 1.0, fine_view)})
    error = np.linalg.norm(fine_view.pixels(tracked[1].corners) - (3.0 * truth[1] + 1.0), axis=-1)
    assert np.median(error) < 0.6


def squeezed(frames, columns, rows):
    """Frames with pixels so many times as wide and as tall, on the same detector."""
    view = frames[0].view
    shape = tuple(int(n / times) for n, times in zip(view.shape, (rows, columns)))
    to_old = np.array([[columns, 0.0, 0.0], [0.0, rows, 0.0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    coarser = replace(view, shape=shape, pixel_spacing=view.pixel_spacing * [columns, rows])
    return [radiograph(cv2.warpAffine(frame.pixels, to_old, shape[::-1], flags=flags), coarser) for frame in frames]


@pytest.mark.parametrize(("columns", "rows"), [(1.4, 1.0), (1.0, 1.4)])
def test_pixels_need_not_be_square(columns, rows):
    frames, truth = sequence(60.0, count=3)
    other = squeezed(frames, columns, rows)
    first = corners(truth[0])
    found = track(other, {0: first})
    error = errors_mm(found, truth)
    assert np.median(error[1:]) <= 0.2
    assert np.percentile(error[1:], 95) <= 0.6
    assert [frame.vertebrae for frame in found] == [first.vertebrae] * 3


def test_the_observer_hears_of_every_frame():
    frames, truth = sequence(4.0, count=3)
    heard = []
    track(frames, {0: corners(truth[0])}, lambda done, total: heard.append((done, total)))
    assert heard == [(2, 3), (3, 3)]
    assert len(track(frames[:1], {0: corners(truth[0])})) == 1


def test_quality_is_low_where_the_error_is_largest():
    """A bright bar slides over some vertebrae and pulls at one of them."""
    frames, truth = sequence(12.0, count=3)
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    barred = []
    for k, frame in enumerate(frames):
        bar = np.exp(-((((row - 260.0) - 0.8 * (column - 180.0)) / 12.0 + 1.2 * k) ** 2))
        barred.append(radiograph((frame.pixels + 160.0 * bar).astype(np.float32)))
    tracked = track(barred, {0: corners(truth[0])})
    error = errors_mm(tracked, truth)[1:].max(axis=(0, 2))
    quality = np.stack([frame.quality for frame in tracked])[1:].min(axis=(0, 2))
    assert error.max() > 0.5
    assert np.argmax(error) in np.argsort(quality)[:2]
    assert quality[np.argmax(error)] < 0.5 * np.median(quality)
    assert quality.min() < 0.5 * np.median(quality)


def test_a_turn_out_of_the_picture_lowers_quality():
    """Arches, discs in front of the bodies here, slide aside while the outlines stay: corners may have moved unseen."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    poses = rest_poses()
    frames = []
    for k, slide in enumerate((0.0, 0.0, 4.0)):
        image = picture(poses, seed=k)
        for _, x, y in poses:
            disc = np.hypot(column - x - slide, row - y) - 5.0
            image = image + np.float32(30.0) / (1.0 + np.exp(np.clip(2.0 * disc, -50, 50))).astype(np.float32)
        frames.append(radiograph(image))
    _, still, turned = track(frames, {0: corners(quads(poses))})
    assert (error_of(turned.quality) > 0.07).all() and (error_of(still.quality) < 0.045).all()


def test_covered_vertebrae_are_lost_and_come_back():
    """Blades close over the lowest vertebrae in one frame of three; lead lets next to nothing through."""
    frames, truth = sequence(10.0, count=4)
    covered = frames[2].pixels.copy()
    covered[440:] = 8.0 + np.random.default_rng(5).normal(0.0, 2.0, covered[440:].shape)
    tracked = track([*frames[:2], radiograph(covered), frames[3]], {0: corners(truth[0])})
    hidden = (truth[2, ..., 1] > 455.0).all(axis=1)
    seen = (truth[2, ..., 1] < 425.0).all(axis=1)
    assert (hidden.sum(), seen.sum()) == (3, 11)
    assert (tracked[2].quality[hidden] < 0.3).all()
    assert (tracked[2].quality[seen] > 0.3).all()
    assert (tracked[3].quality[hidden] > 0.3).all()
    assert errors_mm(tracked, truth)[3].max() < 0.5


def test_a_vertebra_found_where_its_neighbour_was_is_lost():
    """The lowest one in sight, half of it behind a blade, resembles the one above it: a whole vertebra off."""
    bodies = [Body.of_vertebra(quad) for quad in quads(rest_poses())[:3]]
    pitch = bodies[1].centre - bodies[0].centre
    together = np.array([[0.05, 4.0, 3.0]] * 3)
    astray = together.copy()
    astray[2, 1:] -= pitch
    alike, hardly = np.array([0.8, 0.7, 0.8]), np.array([0.8, 0.7, 0.4])
    assert (credits(bodies, together, hardly) > FOUND).all()
    assert (credits(bodies, astray, hardly) > FOUND).tolist() == [True, True, False]
    # What is found so well is believed, even so far off.
    assert (credits(bodies, astray, alike) > FOUND).all()


def test_exposure_may_drift():
    """Half and twice the signal, another gamma, more noise in the darker frames: the corners stay."""
    frames, truth = sequence(15.0, count=4)
    drifted = [frames[0]]
    for frame, gain, gamma in zip(frames[1:], (0.5, 2.0, 1.2), (1.0, 0.9, 1.3)):
        grey = np.clip(frame.pixels, 0.0, None) / 255.0
        drifted.append(radiograph((255.0 * gain * grey**gamma).astype(np.float32)))
    assert np.percentile(errors_mm(track(drifted, {0: corners(truth[0])}), truth), 95) <= 0.3


# Annotated frames anywhere


@pytest.mark.parametrize("start", [2, 4])
def test_tracking_runs_in_both_directions(start):
    """From the middle, and from the last frame back to the first."""
    frames, truth = sequence(30.0, count=5)
    tracked = track(frames, {start: corners(truth[start])})
    error = errors_mm(tracked, truth)
    assert error[start].max() < 1e-9
    assert np.median(error[[k for k in range(5) if k != start]]) <= 0.15
    assert np.percentile(error, 95) <= 0.5


def test_a_corrected_frame_bends_the_tracks_on_both_sides():
    """Corners annotated 3 pixels to one side in the first frame, right in the fourth: between them the error fades."""
    frames, truth = sequence(2.0, count=6)
    wrong = corners(truth[0] + [3.0, 0.0])
    alone = errors_mm(track(frames, {0: wrong}), truth).mean(axis=(1, 2)) / PLANE_MM
    both = errors_mm(track(frames, {0: wrong, 3: corners(truth[3])}), truth).mean(axis=(1, 2)) / PLANE_MM
    assert alone == pytest.approx(np.full(6, 3.0), abs=0.2)
    assert both == pytest.approx([3.0, 2.0, 1.0, 0.0, 0.0, 0.0], abs=0.4)


def test_one_vertebra_corrected_leaves_the_others_to_the_first_frame():
    frames, truth = sequence(20.0, count=4)
    first = track(frames, {0: corners(truth[0])})
    one = VertebraCorners(("T6",), VIEW.from_pixels(truth[2, 5:6] + [2.0, 0.0]))
    tracked = track(frames, {0: corners(truth[0]), 2: one})
    others = [i for i in range(16) if i != 5]
    for k in range(4):
        assert tracked[k].vertebrae == VERTEBRAE[:16]
        np.testing.assert_array_equal(tracked[k].corners[others], first[k].corners[others])
    np.testing.assert_array_equal(tracked[2].corners[5], one.corners[0])
    off = (VIEW.pixels(tracked[3].corners[5]) - truth[3, 5]).mean(axis=0)
    assert off == pytest.approx([2.0, 0.0], abs=0.3)


def test_a_vertebra_that_the_first_frame_lacks_is_followed_back():
    frames, truth = sequence(20.0, count=4)
    some = VertebraCorners(VERTEBRAE[:15], VIEW.from_pixels(truth[0, :15]))
    rest = VertebraCorners(VERTEBRAE[15:16], VIEW.from_pixels(truth[3, 15:]))
    tracked = track(frames, {0: some, 3: rest})
    assert all(frame.vertebrae == VERTEBRAE[:16] for frame in tracked)
    assert errors_mm(tracked, truth).max() < 0.5


# Supports

PELVIS = np.array([[90.0, 520.0], [270.0, 520.0]])
SHOULDER = np.array([[300.0, 90.0]])


def supported(shifts, turns=(0.0, 0.0, 0.0)):
    """Frames with a disc at each support point; ``shifts`` (F, 2) pixels of the pelvis, which also turns."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    middle = PELVIS.mean(0)
    frames = []
    for k, (shift, angle) in enumerate(zip(np.asarray(shifts, dtype=float), turns)):
        image = picture(pushed_poses(rest_poses(), 10.0 * k), seed=k).astype(float)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        for x, y in (*(middle + (PELVIS - middle) @ turn.T + shift), *SHOULDER):
            image += 40.0 / (1.0 + np.exp(np.clip(np.hypot(column - x, 0.7 * (row - y)) - 12.0, -50, 50)))
        frames.append(radiograph(image.astype(np.float32)))
    return frames


def test_a_support_that_moved_is_noted():
    limit = SUPPORT_LIMIT_MM / PLANE_MM
    frames = supported([[0.0, 0.0], [0.7 * limit, 0.0], [1.4 * limit, 0.0]])
    pelvis, shoulder = support_motion(frames, {"pelvis": PELVIS, "shoulder": SHOULDER})
    assert pelvis.displacement[:, 0] == pytest.approx([0.0, 2.1, 4.2], abs=0.2)
    assert pelvis.moved.tolist() == [False, False, True]
    assert shoulder.distance.max() < 0.3
    assert not shoulder.notes()
    note = pelvis.notes()[2]
    assert re.fullmatch(r"the pelvis moved by 4\.\d mm, obliquity [+-]0\.\d degrees", note)


@pytest.mark.parametrize(("columns", "rows"), [(1.4, 1.0), (1.0, 1.4)])
def test_a_support_moves_and_turns_alike_where_pixels_are_not_square(columns, rows):
    frames = supported([[0.0, 0.0], [8.0, -6.0]], turns=(0.0, 0.06))
    (pelvis,) = support_motion(frames, {"pelvis": PELVIS})
    (other,) = support_motion(squeezed(frames, columns, rows), {"pelvis": PELVIS / [columns, rows]})
    assert other.displacement[1] == pytest.approx(pelvis.displacement[1], abs=0.15)
    assert np.linalg.norm(pelvis.displacement[1]) > 3.0
    assert other.turn[1] == pytest.approx(pelvis.turn[1], abs=0.006)


def test_a_support_moves_to_the_left_and_up():
    """Columns grow to the patient's left, rows to the feet."""
    frames = supported([[0.0, 0.0], [4.0, -3.0]])
    (pelvis,) = support_motion(frames, {"pelvis": PELVIS})
    assert pelvis.displacement[1] == pytest.approx([4.0 * PLANE_MM, 3.0 * PLANE_MM], abs=3.0 * pelvis.error[1])


def test_a_pelvis_that_turns_about_its_middle_has_an_obliquity_and_has_not_moved():
    """Clockwise in the picture the patient's left side sinks: a turn about +z below 0."""
    frames = supported(np.zeros((3, 2)), turns=(0.0, 0.03, -0.08))
    (pelvis,) = support_motion(frames, {"pelvis": PELVIS})
    assert pelvis.distance.max() < 0.8
    assert pelvis.turn_seen.all()
    assert pelvis.turn == pytest.approx([0.0, -0.03, 0.08], abs=3.0 * pelvis.turn_error.max())
    # Two points, each known to FLESH_MM and what tracking predicts, at a distance of 0.7 * 180 mm.
    least = np.sqrt(2.0) * FLESH_MM["pelvis"] / (180.0 * PLANE_MM)
    assert least < pelvis.turn_error[1] < 2.0 * least
    assert pelvis.moved.tolist() == [False, False, True]
    assert pelvis.notes()[2].endswith(f"obliquity {np.degrees(pelvis.turn[2]):+.1f} degrees")


def test_a_single_point_shows_no_turn():
    frames = supported(np.zeros((3, 2)), turns=(0.0, 0.06, 0.12))
    (one,) = support_motion(frames, {"pelvis": PELVIS[:1]})
    assert one.moved[2]
    assert not one.turn_seen.any()
    assert "obliquity" not in one.notes()[2]
    (twice,) = support_motion(frames, {"pelvis": PELVIS[[0, 0]]})
    assert not twice.turn_seen.any()


def test_a_turn_is_no_motion_where_a_point_is_lost():
    """Points at a triangle's corners, turned about their middle; the last is lost in the last frame."""
    start = np.array([[-60.0, 0.0], [60.0, 0.0], [0.0, 45.0]])
    angle = 0.1
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    about = start - start.mean(axis=0)
    shifts = np.stack([np.zeros((3, 2)), about @ turn.T - about, about @ turn.T - about]) + [
        [[0.0, 0.0]],
        [[2.0, 1.0]],
        [[2.0, 1.0]],
    ]
    sds = np.full((3, 3), 0.3)
    sds[2, 2] = np.inf
    seen = [_turn(start, moved, sd) for moved, sd in zip(shifts, sds)]
    mean, error = _middle(start, shifts, sds, *np.array(seen).T)
    np.testing.assert_allclose(mean, [[0.0, 0.0], [2.0, 1.0], [2.0, 1.0]], atol=1e-9)
    assert error[0] == error[1] == pytest.approx(0.3 / np.sqrt(3.0))
    # The middle of the other two lies 15 mm away, their turn is known to that of 0.3 mm over 120.
    assert error[2] == pytest.approx(np.hypot(0.3 / np.sqrt(2.0), 15.0 * np.sqrt(2.0) * 0.3 / 120.0))


def test_a_single_point_that_is_left_of_two_allows_for_a_turn():
    frames = supported(np.zeros((2, 2)), turns=(0.0, 0.05))
    lost = np.array(frames[1].pixels)
    row, column = (int(PELVIS[1][1]), int(PELVIS[1][0]))
    lost[row - 45 : row + 45, column - 45 : column + 45] = 50.0
    (pelvis,) = support_motion([frames[0], radiograph(lost)], {"pelvis": PELVIS})
    assert pelvis.seen[1] and not pelvis.turn_seen[1]
    away = 0.5 * np.linalg.norm(PELVIS[1] - PELVIS[0]) * PLANE_MM
    # A turn of 0.05, twice what is allowed for as a standard deviation.
    assert pelvis.distance[1] == pytest.approx(0.05 * away, abs=3.0 * FLESH_MM["pelvis"])
    assert pelvis.distance[1] < 2.5 * pelvis.error[1]


def test_a_support_that_is_not_visible_says_nothing():
    frames = supported(np.zeros((2, 2)))
    frames[1] = radiograph(np.full(SHAPE, 50.0, dtype=np.float32))
    (pelvis,) = support_motion(frames, {"pelvis": PELVIS})
    assert pelvis.seen.tolist() == [True, False]
    assert pelvis.turn_seen.tolist() == [True, False]
    assert not pelvis.moved.any()
    assert support_motion(frames, {}) == ()


def test_a_shoulder_that_slides_is_known_less_well():
    """The slide along its wall takes it out of the patient plane; a pelvis does not slide."""
    frames = supported([[0.0, 0.0], [0.0, -20.0]])
    pelvis, shoulder = support_motion(frames, {"pelvis": PELVIS, "shoulder": PELVIS})
    slide = shoulder.displacement[1, 1]
    assert slide > 5.0
    assert pelvis.displacement[1, 1] == slide
    off_axis = 90.0 * PLANE_MM / VIEW.source_to_patient
    own = FLESH_MM["shoulder"] / np.sqrt(2.0)
    assert shoulder.error[0] == pytest.approx(own)
    assert shoulder.error[1] > np.hypot(own, 0.19 * off_axis * slide)
    assert pelvis.error[0] == pytest.approx(FLESH_MM["pelvis"] / np.sqrt(2.0))


def test_the_edge_of_the_skin_does_not_take_a_support_along():
    """Bone at rest beside a skin that slides: its edge has ten times the contrast."""
    column = np.arange(SHAPE[1], dtype=float)[None]
    row = np.arange(SHAPE[0], dtype=float)[:, None]
    point = np.array([[270.0, 300.0]])
    frames = []
    for k, shift in enumerate((0.0, 5.0)):
        skin = 400.0 / (1.0 + np.exp((column - 285.0 - shift) / 2.0)) * np.ones(SHAPE)
        bone = 40.0 / (1.0 + np.exp(np.clip(np.hypot(column - 262.0, row - 300.0) - 10.0, -50, 50)))
        noise = np.random.default_rng(k).standard_normal(SHAPE)
        frames.append(radiograph((skin + bone + 2.0 * noise).astype(np.float32)))
    (pelvis,) = support_motion(frames, {"pelvis": point})
    assert pelvis.seen[1]
    assert pelvis.distance[1] < 3.0 * FLESH_MM["pelvis"]


# Refusals


def test_frames_that_belong_to_no_sequence():
    frames, truth = sequence(4.0, count=2)
    first = corners(truth[0])
    with pytest.raises(TrackingError, match="no frames"):
        track([], {0: first})
    smaller = radiograph(frames[1].pixels[:-1], frontal_view(shape=(SHAPE[0] - 1, SHAPE[1]), pixel=0.7))
    with pytest.raises(TrackingError, match=r"frame 1 has shape \(619, 360\), frame 0 \(620, 360\)"):
        track([frames[0], smaller], {0: first})
    with pytest.raises(TrackingError, match="frame 1 has another pixel spacing"):
        track([frames[0], replace(frames[1], view=frontal_view(shape=SHAPE, pixel=0.5))], {0: first})
    with pytest.raises(TrackingError, match="one grey value"):
        track([radiograph(np.ones(SHAPE, dtype=np.float32)), frames[1]], {0: first})
    with pytest.raises(TrackingError, match="no annotated frame to track from"):
        track(frames, {})
    with pytest.raises(TrackingError, match="no annotated frame to track from"):
        track(frames, {0: first.selected(())})
    with pytest.raises(TrackingError, match="frame 2 is annotated, but the sequence has 2 frames"):
        track(frames, {0: first, 2: first})
    with pytest.raises(TrackingError, match="no annotated vertebra was found"):
        track([frames[0], radiograph(np.ones(SHAPE, dtype=np.float32))], {0: first})


def test_corners_and_points_outside_the_first_frame():
    frames, truth = sequence(4.0, count=2)
    with pytest.raises(TrackingError, match="T1 lies outside frame 0 of 360 columns and 620 rows"):
        track(frames, {0: corners(truth[0] - [0.0, 60.0])})
    with pytest.raises(TrackingError, match="a pelvis point lies outside"):
        support_motion(frames, {"pelvis": PELVIS + [0.0, 200.0]})


# A rendered torso


def test_vertebrae_of_a_rendered_torso():
    """Each vertebra with its ribs moved as a body, as a push of some 12 mm does; skin and exposure follow."""
    from spinestiff.anatomy.names import BONE_INDEX, BONES
    from spinestiff.anatomy.rotation import exp_so3
    from spinestiff.anatomy.state import TorsoState
    from spinestiff.anatomy.template import template_torso
    from spinestiff.imaging.features import silhouette_shares, state_features
    from spinestiff.imaging.synthetic.detector import Exposure, expose
    from spinestiff.imaging.synthetic.materials import Material
    from spinestiff.imaging.synthetic.rendering import Absorber, thicknesses

    torso = template_torso(150.0)
    rest = torso.rest_pose
    spine = rest.bone_positions[:17]
    view = frontal_view(shape=(1100, 700), pixel=0.45, centre=(0.0, float(spine[[0, -1], 1].mean()), 0.0))
    carrier = np.arange(len(BONES))
    for name in BONES:
        if name[0] == "R":
            carrier[BONE_INDEX[name]] = BONE_INDEX["T" + name[1:].split("_")[0]]
    low, high = rest.bone_positions[BONE_INDEX["pelvis"], 1], spine[0, 1]

    def bend(y, millimetres):
        phase = np.pi * np.clip((y - low) / (high - low), 0.0, 1.0)
        return millimetres * np.sin(phase), millimetres * np.pi / (high - low) * np.cos(phase)

    def posed(millimetres):
        centres = rest.bone_positions[carrier]
        aside, slope = bend(centres[:, 1], millimetres)
        turn = np.stack([exp_so3(np.array([0.0, 0.0, -s])) for s in slope])
        turned = np.einsum("bij,bj->bi", turn, rest.bone_positions - centres)
        positions = centres + turned + np.column_stack([aside, 0.0 * aside, 0.0 * aside])
        return TorsoState(positions, turn @ rest.bone_rotations, rest.tissue_positions)

    def rendered(state, millimetres, seed, factor):
        skin = np.array(torso.tissue.rest_positions)
        skin[:, 0] += bend(skin[:, 1], millimetres)[0]
        bodies = [Absorber(skin, torso.tissue.boundary_faces()[:, :3], smoothing=4.0)]
        for surface, position, rotation in zip(torso.bone_surfaces, state.bone_positions, state.bone_rotations):
            world = surface.vertices @ rotation.T + position
            bodies.append(Absorber(world, surface.faces, Material.BONE, 0.28, 0.9, 0.72))
        return expose(thicknesses(bodies, view), view, Exposure(factor=factor), seed).astype(np.float32)

    states = [posed(push) for push in (0.0, 6.0, 12.0)]
    images = [rendered(s, p, i, f) for i, (s, p, f) in enumerate(zip(states, (0.0, 6.0, 12.0), (1.0, 1.25, 0.8)))]
    shares = silhouette_shares(torso, view, rest)
    truth = [state_features(torso, view, state, shares).corners for state in states]
    tracked = track([radiograph(image, view) for image in images], {0: VertebraCorners(VERTEBRAE, truth[0])})
    error = np.linalg.norm(np.stack([f.corners for f in tracked[1:]]) - truth[1:], axis=-1) / view.magnification
    assert np.median(error) <= 0.15
    assert np.percentile(error, 95) <= 0.5
    assert np.mean([frame.quality > 0.3 for frame in tracked[1:]]) > 0.9


def test_errors_and_qualities_are_inverse():
    errors = np.array([0.0, 0.17, 0.5, 3.0])
    assert error_of(quality_of(errors)) == pytest.approx(errors)
    assert quality_of(errors)[1] == pytest.approx(0.5)
    assert np.isinf(error_of(np.zeros(1))).all()
