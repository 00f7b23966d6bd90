"""Cobb angles of images: curves, regions, signs, uncertainty; and 481 labelled radiographs."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from spine_images import LABELLED, image, labelled_csv, labelled_images
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.curves.cobb import CobbReading, read_cobb, read_cobb_of_view, spine_curves
from spinestiff.curves.corner_files import UnreadableImage, read_corner_file
from spinestiff.errors import SpinestiffError, SubjectError
from spinestiff.study.report.cobb_picture import MOST_PANELS, draw_readings, write_picture

# Convex to the right (T1-T5), to the left (T5-T11), to the right (T11-L4) as seen, with a tail that comes back.
TRIPLE = [0, 4, 8, 12, 15, 10, 4, -4, -12, -20, -25, -15, -5, 5, 12, 18, 14]


def test_a_triple_curve_with_its_regions():
    found = read_cobb(image(TRIPLE), "midline")
    assert found.status == "ok" and found.warnings == ()
    ends = [(c.angle.upper, c.angle.lower, round(c.angle.degrees, 6)) for c in found.curves]
    assert ends == [("T1", "T5", -15.0), ("T5", "T11", 40.0), ("T11", "L4", -43.0)]
    assert [c.region for c in found.curves] == ["proximal_thoracic", "main_thoracic", "thoracolumbar_lumbar"]
    assert found.curves[1].apex in ("T7-T8", "T8")
    assert found.largest is found.curves[2]
    assert {n: c.angle.upper for n, c in found.by_region().items() if c} == {
        "proximal_thoracic": "T1",
        "main_thoracic": "T5",
        "thoracolumbar_lumbar": "T11",
    }


def test_curves_below_five_degrees_are_noise_beside_the_largest():
    found = read_cobb(image([0, 4, 0, 10, 20, 10, 0, -10, -6]), "midline")
    assert [(c.angle.upper, c.angle.lower) for c in found.curves] == [("T3", "T5"), ("T5", "T8")]
    assert read_cobb(image([0, 1, 2]), "midline").largest.angle.degrees == pytest.approx(-2.0)


@pytest.mark.parametrize(
    ("place", "region"),
    [
        ("T3", "proximal_thoracic"),
        ("T5", "proximal_thoracic"),
        ("T5-T6", "main_thoracic"),
        ("T11-T12", "main_thoracic"),
        ("T12", "thoracolumbar_lumbar"),
        ("L3", "thoracolumbar_lumbar"),
    ],
)
def test_the_region_is_that_of_the_apex(place, region):
    """Tilts that are alike above and below the wanted place put the apex there, be it a vertebra or a disc."""
    at = np.mean([VERTEBRAE.index(level) for level in place.split("-")])
    degrees = [float(np.clip(8.0 * (at - i), -20, 20)) for i in range(17)]
    rows = slice(int(at) - 2, int(np.ceil(at)) + 3)
    found = read_cobb(image(degrees[rows], start=rows.start), "midline")
    assert (found.largest.apex, found.largest.region) == (place, region)


def test_the_apex_of_two_neighbours_is_the_disc_between_them():
    assert read_cobb(image([10, -10], start=10), "midline").largest.apex == "T11-T12"


def test_endplates_count_the_wedge_of_both_end_vertebrae():
    degrees = [15, 10, 5, 0, -5, -10, -15]
    for wedge in (3.0, -2.0):
        found = read_cobb(image(degrees, start=4, wedge=wedge))
        assert found.largest.angle.degrees == pytest.approx(30.0 + 2.0 * wedge)
        assert read_cobb(image(degrees, start=4, wedge=wedge), "midline").largest.angle.degrees == pytest.approx(30.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_sides_are_the_images_until_the_patients_are_known(sign):
    """The upper end's right side is higher: the spine bulges to the image's right."""
    spine = image(sign * np.linspace(20, -20, 9), start=3)
    middles = spine.corners.mean(1)
    side = "right" if middles[4, 0] > middles[[0, -1], 0].mean() else "left"
    assert side == ("right" if sign > 0 else "left")
    other = {"left": "right", "right": "left"}[side]
    words = {
        None: f"convex to the image's {side}",
        "left": f"convex to the patient's {side}",
        "right": f"convex to the patient's {other}",
    }
    for known, text in words.items():
        for found in (read_cobb(spine, patient_left=known), read_cobb(replace(spine, first_on=known))):
            assert found.convexity(found.largest) == text
            assert found.patient_left == known
            assert found.bulges_right(found.largest) == (side == "right")
            assert (found.largest.angle.degrees > 0) == text.endswith(("patient's left", "image's right"))
    assert read_cobb(replace(spine, first_on="left"), patient_left="left").status == "ok"
    contradiction = read_cobb(replace(spine, first_on="left"), patient_left="right")
    assert contradiction.status == "refused" and "left on the left, not on the right" in contradiction.warnings[0]


def test_corners_that_a_view_oriented_read_like_those_of_the_usual_display():
    spine = image(TRIPLE, first_on="right", unit="mm", wedge=1.0)
    points = (spine.corners * [1.0, -1.0])[:, [1, 0, 3, 2]]
    seen, viewed = read_cobb(spine), read_cobb_of_view(spine.image, spine.levels, points)
    assert viewed.as_dict() == seen.as_dict()
    assert np.array_equal(viewed.corners, seen.corners)
    assert "corner noise alone" in read_cobb_of_view("a", spine.levels, points, noise=20.0).warnings[0]


def test_a_straight_spine_has_no_convexity():
    found = read_cobb(image([5.0] * 9))
    assert found.largest.angle.degrees == pytest.approx(0.0, abs=1e-9)
    assert read_cobb(image([0.0] * 9)).as_dict()["convexity"] == "straight"


@pytest.mark.parametrize("definition", ["endplate", "midline"])
def test_the_noise_of_the_corners_is_that_of_the_angle(definition):
    """4,000 draws of noise on the corners: the spread of the angle between the same end vertebrae."""
    spine = image(TRIPLE, wedge=2.0)
    found = read_cobb(spine, definition, noise=2.0)
    rng = np.random.default_rng(0)
    i, j = (VERTEBRAE.index(level) for level in (found.largest.angle.upper, found.largest.angle.lower))
    pair = spine.corners[[i, j]]
    noisy = pair + rng.normal(0.0, 2.0, (4000, *pair.shape))
    if definition == "midline":
        across = 0.5 * (noisy[:, :, 1] + noisy[:, :, 2] - noisy[:, :, 0] - noisy[:, :, 3])
    else:
        across = np.stack([noisy[:, 0, 1] - noisy[:, 0, 0], noisy[:, 1, 2] - noisy[:, 1, 3]], 1)
    tilt = np.degrees(np.arctan2(-across[..., 1], across[..., 0]))
    assert found.largest.sd_deg == pytest.approx(np.std(tilt[:, 0] - tilt[:, 1]), rel=0.05)
    assert found.noise == 2.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"definition": "cobb"}, "unknown definition 'cobb'; wanted endplate or midline"),
        ({"noise": -1.0}, "noise of corners: found -1.0, wanted a finite number of 0 or more"),
        ({"noise": float("nan")}, "noise of corners: found nan"),
        ({"noise": float("inf")}, "noise of corners: found inf"),
    ],
)
def test_impossible_definitions_and_noises_are_refused(options, words):
    spine = image(TRIPLE)
    for read in (
        lambda: read_cobb(spine, **options),
        lambda: spine_curves(spine.levels, spine.corners, **{"definition": "endplate", **options}),
    ):
        with pytest.raises(SpinestiffError, match=words):
            read()


def test_no_reading_makes_no_picture():
    with pytest.raises(SubjectError, match="no reading of Cobb angles to draw; wanted at least one"):
        draw_readings([])


def test_the_default_noise_follows_the_vertebrae():
    assert read_cobb(image(TRIPLE, width=120.0)).noise == pytest.approx(2.4)
    assert read_cobb(image(TRIPLE, width=6.0, height=4.0)).noise == pytest.approx(0.3)
    assert read_cobb(image(TRIPLE, width=6.0, height=4.0, unit="mm", first_on="right")).noise == pytest.approx(0.12)
    tiny = read_cobb(image(TRIPLE, width=1.0, height=1.0))
    assert tiny.status == "ok" and tiny.largest.sd_deg > 20.0
    assert "so small that corner noise makes" in tiny.warnings[-1]


@pytest.mark.parametrize("definition", ["endplate", "midline"])
def test_a_straight_spine_is_told_from_a_curved_one(definition):
    """A largest angle that corner noise makes of a straight spine is warned of in 19 of 20 cases; 20 degrees never."""
    rng = np.random.default_rng(1)
    straight, curved = image([0.0] * 17), image(np.linspace(10, -10, 17))

    def warned(spine):
        noisy = replace(spine, corners=spine.corners + rng.normal(0.0, 2.4, (17, 4, 2)))
        return any("corner noise alone" in warning for warning in read_cobb(noisy, definition).warnings)

    assert 0.9 <= np.mean([warned(straight) for _ in range(300)]) < 1.0
    assert not any(warned(curved) for _ in range(50))


def test_what_cannot_be_measured_is_refused_with_the_reason():
    unreadable = read_cobb(UnreadableImage("a", "row 3: x is 'nan', wanted a number"))
    assert (unreadable.status, unreadable.warnings) == ("refused", ("row 3: x is 'nan', wanted a number",))
    alone = read_cobb(image([3.0]))
    record = alone.as_dict()
    assert record["status"] == "refused" and "at least two vertebrae" in record["warnings"][0]
    keys = ("largest_deg", "upper_level", "lower_level", "signed_deg", "sd_deg", "convexity", "noise")
    assert all(record[key] is None for key in keys)
    assert record["curves"] == [] and set(record["regions"].values()) == {None}


def test_a_repair_shows_in_status_and_angle():
    spine = image(TRIPLE)
    corners = spine.corners.copy()
    corners[10] = corners[10, [1, 0, 3, 2]]
    found = read_cobb(replace(spine, corners=corners))
    assert found.status == "repaired" and "T11 corners were out of order" in found.warnings[0]
    assert found.largest == read_cobb(spine).largest


def test_records_are_json():
    record = json.loads(json.dumps(read_cobb(image(TRIPLE)).as_dict(), allow_nan=False))
    assert {"image", "largest_deg", "upper_level", "lower_level", "status", "warnings"} <= set(record)
    assert record["largest_deg"] == abs(record["signed_deg"])


def test_corners_that_coincide_have_no_tilt():
    points = np.zeros((2, 4, 2))
    with pytest.raises(Exception, match="coincide"):
        spine_curves(("T1", "T2"), points, "endplate", 1.0)


def readings(count=1, sign=1):
    return [read_cobb(image(np.multiply(sign, TRIPLE), name=f"image {i}", first_on="right")) for i in range(count)]


@pytest.mark.parametrize("sign", [1, -1])
def test_a_picture_has_every_image_and_its_angles(tmp_path, sign):
    figure = draw_readings([*readings(2, sign), CobbReading("bad", "refused", ("a reason",), "endplate")])
    panels = [axis for axis in figure.axes if axis.get_title()]
    assert [axis.get_title().split("\n")[0] for axis in panels] == ["image 0", "image 1", "bad"]
    words = [text.get_text() for text in panels[0].texts]
    assert {"T1", "L5", "R", "L"} <= set(words)
    assert sum("°" in word for word in words) == len(readings(1, sign)[0].curves)
    assert "a reason" in panels[2].texts[0].get_text()
    # The solid lines lie along the endplates of the largest curve's end vertebrae and reach to its hollow side.
    found = readings(1, sign)[0]
    rows = [VERTEBRAE.index(level) for level in (found.largest.angle.upper, found.largest.angle.lower)]
    plates = [found.corners[rows[0]][[0, 1]], found.corners[rows[1]][[3, 2]]]
    lines = [
        line.get_xydata() for line in panels[0].lines if line.get_linestyle() == "-" and line.get_linewidth() == 2.0
    ]
    assert len(lines) == 2
    for (left, right), (start, end) in zip(plates, lines):
        across = np.array([-(right - left)[1], (right - left)[0]])
        assert (np.array([start, end]) - left) @ across == pytest.approx(0.0, abs=1e-6)
        bulge = found.corners[rows[0] : rows[1] + 1].mean(1)[:, 0]
        assert (end[0] > start[0]) == (bulge[len(bulge) // 2] < bulge[[0, -1]].mean())
    write_picture(readings(), tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_a_picture_that_no_page_holds_is_refused(tmp_path):
    with pytest.raises(SubjectError, match="split the file"):
        write_picture(readings() * (MOST_PANELS + 1), tmp_path / "a.png")
    with pytest.raises(SubjectError, match=r"ends in .png"):
        write_picture(readings(), tmp_path / "a.svg")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not LABELLED.is_dir(), reason="the labelled scoliosis radiographs are not here")
def test_labelled_radiographs(tmp_path):
    """481 labelled spines: in order the angle is the data set's, out of order never without a word."""
    angles = labelled_csv(tmp_path / "labelled.csv")
    images = read_corner_file(tmp_path / "labelled.csv").images
    found = [read_cobb(entry, "midline") for entry in images]
    assert Counter(reading.status for reading in found) == {"ok": 454, "repaired": 16, "refused": 11}
    off = [abs(abs(r.largest.angle.degrees) - angle) for r, angle in zip(found, angles) if r.largest]
    assert max(off) < 0.02
    assert all(reading.warnings for reading in found if reading.status != "ok")
    assert found[480].status == "refused"  # the angle of 156 degrees
    # Which rows are out of order, told in another way: by the signs of the corners' areas and the order of the middles.
    quads = np.array([entry.corners for entry in images])
    x, y = quads[..., 0], quads[..., 1]
    corner = [(x[..., (k + 1) % 4] - x[..., k]) * (y[..., (k + 2) % 4] - y[..., k]) for k in range(4)]
    corner = [c - (x[..., (k + 2) % 4] - x[..., k]) * (y[..., (k + 1) % 4] - y[..., k]) for k, c in enumerate(corner)]
    sound = (np.array(corner) > 0).all((0, 2)) & (np.diff(y.mean(-1), axis=1) > 0).all(1)
    assert [reading.status == "ok" for reading in found] == sound.tolist()


@pytest.mark.skipif(not LABELLED.is_dir(), reason="the labelled scoliosis radiographs are not here")
@pytest.mark.parametrize("kind", ["displaced", "turned"])
def test_a_spoiled_radiograph_is_not_repaired_to_something_else(kind):
    """One vertebra of each radiograph moved by up to three widths, or turned by 90 degrees: right, noise or refused."""
    rng = np.random.default_rng(0)
    status: Counter[str] = Counter()
    for spine in labelled_images()[0][:480:3]:
        sound = read_cobb(spine, "midline")
        if sound.status != "ok":
            continue
        at, corners = rng.integers(17), spine.corners.copy()
        middle, quad = corners[at].mean(axis=0), corners[at]
        width = np.hypot(*(quad[1] - quad[0]))
        if kind == "displaced":
            corners[at] = quad + rng.uniform(0.3, 3.0) * width * np.array([1.0, 0.0]) * rng.choice([-1.0, 1.0])
        else:
            corners[at] = middle + (quad - middle) @ [[0.0, 1.0], [-1.0, 0.0]]
        found = read_cobb(replace(spine, corners=corners), "midline")
        status[found.status] += 1
        if found.status == "repaired":
            off = abs(abs(found.largest.angle.degrees) - abs(sound.largest.angle.degrees))
            assert off <= found.largest.half_width_deg, (spine.image, VERTEBRAE[at])
    assert status["refused"] > 100
