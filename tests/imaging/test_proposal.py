"""Boxes proposed from a few clicks: on drawn spines with known corners, and on real radiographs with labels."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from phantoms import phantom
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.template.sizes import VERTEBRA_SIZES
from spinestiff.errors import TrackingError
from spinestiff.imaging.expected_spine import ExpectedSpine
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.imaging.proposal import leans_of, propose_boxes
from spinestiff.imaging.radiograph import Radiograph

CLICKED = ("T1", "T5", "T8", "T11", "L2", "L5")
REAL = Path(__file__).parents[3] / "shared" / "data" / "scoliosis_radiographs"
# Rows whose labels show 17 bodies in order; the labels of the other four images hold doubled or misplaced bodies.
LABELLED = (0, 60, 240, 300, 360)
SPINE_MM = 390.0  # from the middle of T1 to the middle of L5, about (the template's)


def radiograph(drawn, kind="frontal"):
    view = frontal_view if kind == "frontal" else lateral_view
    return Radiograph(drawn.pixels, view(shape=drawn.pixels.shape))


def errors(found, wanted, mm=0.72):
    return np.linalg.norm(found - wanted, axis=2) * mm


@pytest.mark.parametrize("kind", ["frontal", "lateral"])
@pytest.mark.parametrize("bend", [-22.0, 0.0, 22.0])
def test_corners_of_drawn_spines_are_found(kind, bend):
    drawn = phantom(kind=kind, bend=bend)
    rng = np.random.default_rng(1)
    clicks = drawn.clicks(*CLICKED) + rng.normal(0.0, 2.0, (6, 2))
    found = propose_boxes(radiograph(drawn, kind), clicks, VERTEBRAE)
    away = errors(found, drawn.quads)
    # A drawn rear wall is as dense at its rims as midway; of a real one the rims show less, which is allowed for.
    assert np.median(away) < (1.0 if kind == "frontal" else 1.3)
    assert np.percentile(away, 95) < 3.0
    # Far better than the anatomy alone, which knows nothing of this picture.
    blank = Radiograph(np.random.default_rng(0).normal(size=drawn.pixels.shape), radiograph(drawn, kind).view)
    assert np.median(errors(propose_boxes(blank, clicks, VERTEBRAE), drawn.quads)) > 2.0 * np.median(away)


def test_a_person_of_another_width_and_size_is_found():
    drawn = phantom(size=1.2, mm=0.8, shape=(600, 448))
    found = propose_boxes(radiograph(drawn), drawn.clicks(*CLICKED), VERTEBRAE)
    assert np.median(errors(found, drawn.quads, 0.8)) < 1.0


@pytest.mark.parametrize(("wide", "tall"), [(1.4, 1.0), (1.0, 1.4)])
def test_pixels_need_not_be_square(wide, tall):
    drawn = phantom(bend=22.0)
    shown = radiograph(drawn)
    rows, columns = (int(n / times) for n, times in zip(drawn.pixels.shape, (tall, wide)))
    to_old = np.array([[wide, 0.0, 0.0], [0.0, tall, 0.0]])
    pixels = cv2.warpAffine(shown.pixels, to_old, (columns, rows), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    view = replace(shown.view, shape=(rows, columns), pixel_spacing=shown.view.pixel_spacing * [wide, tall])
    there, kept = np.array([wide, tall]), {"T8": drawn.quads[7] / [wide, tall]}
    found = propose_boxes(Radiograph(pixels, view), drawn.clicks(*CLICKED) / there, VERTEBRAE, kept)
    np.testing.assert_array_equal(found[7], kept["T8"])
    usual = propose_boxes(shown, drawn.clicks(*CLICKED), VERTEBRAE, {"T8": drawn.quads[7]})
    assert np.median(errors(found * there, usual)) < 0.15
    leans = leans_of(view, {"T8": found[7], "T3": found[2]})
    assert leans == pytest.approx(leans_of(shown.view, {"T8": drawn.quads[7], "T3": found[2] * there}), abs=1e-9)


def test_part_of_a_spine_is_proposed_between_its_own_ends():
    drawn = phantom()
    names = VERTEBRAE[3:15]
    found = propose_boxes(radiograph(drawn), drawn.clicks("T4", "T8", "T12", "L3"), names)
    assert np.median(errors(found, drawn.quads[3:15])) < 1.0


def test_a_lung_beside_the_spine_does_not_draw_the_boxes_away():
    """Bodies that hardly show beside an edge 8 mm from their walls that does: the clicks say where the middle is."""
    drawn = phantom(bend=0.0)
    upper = np.arange(drawn.pixels.shape[0]) < drawn.quads[8, 0, 1]
    faint = 0.85 * cv2.GaussianBlur(drawn.pixels, (0, 0), 6.0) + 0.15 * drawn.pixels
    beside = np.arange(drawn.pixels.shape[1]) > drawn.quads[:6, 0, 0].max() + 8.0 / 0.72
    lung = cv2.GaussianBlur(np.outer(upper, beside).astype(np.float32), (0, 0), 2.0)
    pixels = np.where(upper[:, None], faint, drawn.pixels) - 0.6 * lung
    clicks = drawn.clicks(*CLICKED) + np.random.default_rng(1).normal(0.0, 2.0, (6, 2))
    found = propose_boxes(Radiograph(pixels.astype(np.float32), radiograph(drawn).view), clicks, VERTEBRAE)
    assert np.percentile(errors(found, drawn.quads), 95) < 3.0


def test_outlines_are_expected_as_kyphosis_and_lordosis_show_them():
    """Seen from the front a body that leans looks taller and its disc lower; one that stands upright looks as it is."""
    view = frontal_view(shape=(640, 448), pixel=0.8)
    expected = ExpectedSpine.of(VERTEBRAE, view, np.array([224.0, 320.0]))
    bodies = np.diff(expected.places)[::2] / VERTEBRA_SIZES[:, 4]
    upright, leaning = VERTEBRAE.index("T7"), VERTEBRAE.index("T2")
    assert abs(bodies[upright] - 1.0) < 0.05
    assert bodies[leaning] > 1.1
    assert (np.diff(expected.places) > -1.0).all()
    assert abs(expected.tilts).max() < 0.01  # from the front a spine without a curve has level endplates


def test_from_the_side_a_vertebra_that_leans_is_expected_taller():
    """By half its width times the lean's sine above and below, about; and its disc by as much lower."""
    view, middle = lateral_view(shape=(640, 448), pixel=0.8), np.array([224.0, 320.0])
    upright = ExpectedSpine.of(VERTEBRAE, view, middle)
    leaning = ExpectedSpine.of(VERTEBRAE, view, middle, {"L1": 0.3, "L2": 0.4, "L3": 0.3, "T12": 0.0, "L4": 0.0})
    taller = (np.diff(leaning.places) - np.diff(upright.places))[::2]
    level = VERTEBRAE.index("L2")
    width, _, _, _, height, _ = VERTEBRA_SIZES[level]
    # The rim is an ellipse: it reaches out by the root of both squares, less the height that it had upright.
    assert 0.3 * width * np.sin(0.4) < taller[level] < width * np.sin(0.4) + height * (np.cos(0.4) - 1.0) + 0.5
    assert np.diff(leaning.places)[2 * level + 1] < np.diff(upright.places)[2 * level + 1] - 3.0
    assert np.abs(taller[: VERTEBRAE.index("T11")]).max() < 0.3


def test_leans_are_those_of_the_marks():
    drawn = phantom(bend=20.0)
    found = leans_of(radiograph(drawn).view, drawn.named())
    across = drawn.quads[:, 0] - drawn.quads[:, 1]
    # Rows of pixels grow downward.
    upper = np.arctan2(-across[:, 1], across[:, 0])
    assert list(found) == list(VERTEBRAE)
    np.testing.assert_allclose(list(found.values()), upper, atol=np.radians(6.0))
    assert np.ptp(upper) > 0.3


def test_the_order_of_the_clicks_does_not_matter():
    drawn = phantom()
    clicks = drawn.clicks(*CLICKED)
    np.testing.assert_array_equal(
        propose_boxes(radiograph(drawn), clicks, VERTEBRAE), propose_boxes(radiograph(drawn), clicks[::-1], VERTEBRAE)
    )


def test_a_line_of_many_points_is_as_good_as_a_few():
    """Points nearer to each other than two pixels are one, but not all of a line of them."""
    drawn = phantom()
    clicks = drawn.clicks(*CLICKED)
    rows = np.arange(clicks[0, 1], clicks[-1, 1], 0.8)
    line = np.stack([np.interp(rows, clicks[:, 1], clicks[:, 0]), rows], axis=1)
    assert np.median(errors(propose_boxes(radiograph(drawn), line, VERTEBRAE), drawn.quads)) < 1.0


def test_what_was_corrected_stays_and_guides_the_others():
    """A level counted wrongly: the vertebra that is put right takes those beside it along."""
    drawn = phantom(noise=0.15)
    clicks = drawn.clicks(*CLICKED)
    # The last click lies one body too high, so that all levels are squeezed.
    clicks[-1] = drawn.clicks("L4")[0] + [0.0, 6.0]
    alone = propose_boxes(radiograph(drawn), clicks, VERTEBRAE)
    kept = {name: drawn.quads[VERTEBRAE.index(name)] for name in ("T12", "L3", "L5")}
    guided = propose_boxes(radiograph(drawn), clicks, VERTEBRAE, kept)
    for name, quad in kept.items():
        np.testing.assert_array_equal(guided[VERTEBRAE.index(name)], quad)
    others = [VERTEBRAE.index(name) for name in ("T11", "L1", "L2", "L4")]
    assert errors(alone, drawn.quads)[others].mean() > 5.0
    assert errors(guided, drawn.quads)[others].mean() < 1.5


def test_how_somebody_sets_corners_is_taken_over():
    """Corners set 2 mm outside the edges on three vertebrae: the others go there, too."""
    drawn = phantom()
    outward = 2.0 / 0.72 * np.array([[1, -1], [-1, -1], [-1, 1], [1, 1]])
    wanted = drawn.quads + outward
    clicks = drawn.clicks(*CLICKED)
    alone = propose_boxes(radiograph(drawn), clicks, VERTEBRAE)
    kept = {name: wanted[VERTEBRAE.index(name)] for name in ("T4", "T9", "L2")}
    guided = propose_boxes(radiograph(drawn), clicks, VERTEBRAE, kept)
    others = [i for i, name in enumerate(VERTEBRAE) if name not in kept]
    assert np.median(errors(alone, wanted)[others]) > 2.0
    assert np.median(errors(guided, wanted)[others]) < 1.2


def test_corners_that_are_as_they_were_proposed_move_no_others():
    drawn = phantom()
    clicks = drawn.clicks(*CLICKED)
    first = propose_boxes(radiograph(drawn), clicks, VERTEBRAE)
    again = propose_boxes(radiograph(drawn), clicks, VERTEBRAE, dict(zip(VERTEBRAE[1::2], first[1::2])))
    lower = 0.72 * (again - first)[::2, :, 1].mean(axis=0)
    # To the step of a quarter of a millimetre in which edges are looked for.
    assert lower == pytest.approx(np.zeros(4), abs=0.25)


@pytest.mark.parametrize(
    "box",
    [
        np.full((4, 2), 200.0),
        [[9, 9], [9, 300], [400, 300], [400, 9]],
        [[180, 300], [260, 300], [260, 270], [180, 270]],
    ],
    ids=["a point", "half the radiograph", "upside down and mirrored"],
)
def test_a_box_that_is_no_vertebra_stays_and_misleads_nobody(box):
    drawn = phantom()
    clicks = drawn.clicks(*CLICKED)
    found = propose_boxes(radiograph(drawn), clicks, VERTEBRAE, {"T8": np.array(box, dtype=float)})
    np.testing.assert_array_equal(found[7], box)
    others = np.arange(17) != 7
    np.testing.assert_array_equal(found[others], propose_boxes(radiograph(drawn), clicks, VERTEBRAE)[others])


def test_pixels_that_count_down_sideways_make_no_difference():
    """The patient's left on the left of the picture: the same boxes, mirrored, corners in the order of the patient."""
    drawn = phantom()
    mirrored = Radiograph(drawn.pixels[:, ::-1], mirrored_view(drawn.pixels.shape))
    width = drawn.pixels.shape[1] - 1
    clicks = drawn.clicks(*CLICKED)
    found = propose_boxes(mirrored, np.stack([width - clicks[:, 0], clicks[:, 1]], axis=1), VERTEBRAE)
    back = np.stack([width - found[..., 0], found[..., 1]], axis=2)
    np.testing.assert_allclose(back, propose_boxes(radiograph(drawn), clicks, VERTEBRAE), atol=0.3)


def mirrored_view(shape):
    from spinestiff.imaging.projection import FRONT, LEFT, UP, placed_view

    return placed_view(
        -LEFT, -UP, -FRONT, sid=1500.0, source_to_patient=1340.0, shape=shape, pixel=0.4, centre=(0.0, 0.0, 0.0)
    )


@pytest.mark.parametrize(
    ("points", "names", "message"),
    [
        ([(200, 100), (200, 400)], VERTEBRAE, "2 points along the spine, wanted 3"),
        ([(200, 100), (200.5, 100.5), (200, 400)], VERTEBRAE, "2 points along the spine, wanted 3"),
        ([(200, 100), (900, 300), (200, 400)], VERTEBRAE, "outside the radiograph of 448 columns, 640 rows"),
        ([(200, 100), (np.nan, 300), (200, 400)], VERTEBRAE, "outside the radiograph of 448 columns, 640 rows"),
        ([(200, 100), (200, 300), (200, 400)], ("T3",), "wanted two or more neighbours"),
        ([(200, 100), (200, 300), (200, 400)], ("T3", "T5"), "wanted two or more neighbours"),
        ([(200, 100), (200, 300), (200, 400)], ("L1", "T12"), "wanted two or more neighbours"),
    ],
)
def test_what_can_not_be_proposed_is_refused(points, names, message):
    with pytest.raises(TrackingError, match=message):
        propose_boxes(radiograph(phantom()), np.array(points, dtype=float), names)


@pytest.mark.skipif(not REAL.is_dir(), reason="labelled radiographs (shared/data/scoliosis_radiographs) are not here")
def test_real_radiographs_are_met_as_well_as_their_labels_tell():
    """The labels themselves lie millimetres off the visible corners; still, most proposals are near them."""
    away = []
    for row in LABELLED:
        pixels, quads = labelled(row)
        steps = np.linspace(0, 16, 6).astype(int)
        clicks = quads[steps].mean(axis=1)
        along = np.linalg.norm(np.diff(quads.mean(axis=1), axis=0), axis=1).sum()
        mm = SPINE_MM / along
        view = frontal_view(shape=pixels.shape)
        away.append(errors(propose_boxes(Radiograph(pixels, view), clicks, VERTEBRAE), quads, mm))
    assert len(away) == len(LABELLED)
    assert np.median(away) < 3.0
    assert np.percentile(away, 90) < 8.0


def labelled(row):
    """A real radiograph, and its labels in the annotation's order (the patient's left taken to be on the right)."""
    with (REAL / "landmarks.csv").open() as file:
        values = np.array([float(x) for x in list(csv.reader(file))[row]])
    pixels = cv2.imread(str(REAL / "images" / f"row{row:03d}.jpg"), cv2.IMREAD_GRAYSCALE)
    assert pixels is not None
    points = np.stack([values[:68] * pixels.shape[1], values[68:] * pixels.shape[0]], axis=1).reshape(17, 4, 2)
    return pixels.astype(np.float32), points[:, [1, 0, 2, 3]]
