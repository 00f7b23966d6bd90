"""Files of vertebra corners: what is read comes out as seen in the image, what is ambiguous is refused in one line."""

from __future__ import annotations

import csv
import json
import re
import time
from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.curves.corner_files import (
    CORNERS,
    ImageCorners,
    UnreadableImage,
    read_corner_file,
    read_corners,
    write_corners,
)
from spinestiff.errors import SubjectError
from spinestiff.subject.annotation_record import Annotation
from spinestiff.subject.record_reading import read_record

QUAD = np.array([[100.0, 50.0], [140.0, 52.0], [141.0, 78.0], [101.0, 76.0]])


def stack(n=8, start=4):
    """The levels and corners, as seen, of a spine of boxes that shift and turn a little, so that no two are alike."""
    shift = np.array([[0.3 * i**2, 30.0 * i + 0.01 * i] for i in range(n)])
    return VERTEBRAE[start : start + n], QUAD + shift[:, None]


def image(name="a", **changes):
    levels, corners = stack()
    return ImageCorners(name, levels, corners, **changes)


def same(found, wanted):
    names = (found.image, found.levels) == (wanted.image, wanted.levels)
    return names and np.array_equal(found.corners, wanted.corners)


@pytest.fixture
def table(tmp_path):
    def write(text):
        path = tmp_path / "corners.csv"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return write


def rows(levels=("T5",), name="a"):
    quads = dict(zip(levels, QUAD + np.arange(len(levels))[:, None, None] * [0.0, 30.0]))
    return [f"{name},{level},{c},{x},{y}" for level in levels for c, (x, y) in zip(CORNERS, quads[level])]


HEAD = "image,level,corner,x,y"


def text(*lines):
    return "\n".join([HEAD, *lines]) + "\n"


def test_csv_comes_back_as_written(tmp_path):
    path = tmp_path / "out.csv"
    written = (image("first"), image("second, with a comma"), image("=HYPERLINK(1)"), image("'quoted"), image("Zürich"))
    write_corners(path, written)
    found = read_corners(path)
    assert len(found) == 5
    assert all(same(f, w) for f, w in zip(found, written))
    assert found[0].unit == "px" and found[0].first_on is None


def test_no_cell_of_a_written_csv_is_a_formula(tmp_path):
    path = tmp_path / "out.csv"
    write_corners(path, [image(name) for name in ("=1+1", "+1", "-1", "@SUM(A1)")])
    with path.open(newline="") as file:
        cells = [row[0] for row in csv.reader(file)]
    assert cells[1:] and not any(cell.startswith(("=", "+", "-", "@")) for cell in cells)


def test_columns_and_rows_may_come_in_any_order(table):
    lines = rows(("T5", "T6"))
    turned = [",".join(reversed(line.split(","))) for line in reversed(lines)]
    found = read_corners(table("\ufeff" + "\n".join([",".join(reversed(HEAD.split(","))), *turned])))
    assert found[0].levels == ("T6", "T5")
    assert np.array_equal(found[0].corners[1], QUAD)


@pytest.mark.parametrize(
    ("content", "name"),
    [
        ({"images": [{"id": 1}], "annotations": [], "categories": []}, "COCO annotations"),
        ({"version": "5", "shapes": [], "imagePath": "a.png"}, "Labelme annotations"),
        ({"_via_img_metadata": {}}, "VGG Image Annotator"),
        ({"type": "FeatureCollection", "features": []}, "GeoJSON"),
    ],
)
def test_annotations_of_other_programs_are_refused_by_name(tmp_path, content, name):
    path = tmp_path / "annotation.json"
    path.write_text(json.dumps(content))
    with pytest.raises(SubjectError, match=f"annotation.json: is a file of {name}, which is not read; wanted a CSV "):
        read_corner_file(path)


@pytest.mark.parametrize("separator", [";", "\t"])
def test_semicolons_tabs_and_decimal_commas_are_read(table, separator):
    lines = [line.replace(",", separator).replace(".", ",") for line in (HEAD, *rows())]
    (found,) = read_corners(table("\n".join(lines)))
    assert found.levels == ("T5",)
    assert np.array_equal(found.corners[0], QUAD)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "is empty, wanted a row with the columns image,level,corner,x,y"),
        ("image,level,corner,x\n", "row 1: columns image,level,corner,x, wanted"),
        (HEAD.replace(",", "|") + "\n", "columns image.level.corner.x.y, wanted image,level"),
        (HEAD + ",score\n", "row 1: columns .*score, wanted"),
        (text(), "no corner in it"),
        (text("a,T5,top_left,1"), "row 2: 4 fields, wanted 5"),
        (text(",T5,top_left,1,2"), "row 2: image name is empty"),
        (text("x" * 201 + ",T5,top_left,1,2"), "row 2: image name has 201 characters"),
        (text("a\x1b[31m,T5,top_left,1,2"), "row 2: image name holds characters"),
        (text('"a,T5,top_left,1,2'), "not CSV"),
        (text('"' + "a" * 200_000 + '",T5,top_left,1,2'), "not CSV"),
        (b"a\x00b", "no text; export the table as CSV"),
    ],
)
def test_a_file_that_is_no_table_of_corners_is_refused(table, content, words):
    with pytest.raises(SubjectError) as error:
        read_corner_file(table(content))
    assert re.search(words, str(error.value)) and "\n" not in str(error.value)


def test_the_record_of_a_subject_has_no_corners(tmp_path):
    (tmp_path / "subject.json").write_text("{}", encoding="utf-8")
    with pytest.raises(
        SubjectError, match=r"subject\.json: has the person and the pushes, but no corners; name its folder"
    ):
        read_corner_file(tmp_path / "subject.json")


def test_levels_and_corners_may_be_written_in_other_letters(table):
    lines = [line.replace("T5", "t5").replace("top_left", "Top_Left") for line in rows(("T5", "T6"))]
    (found,) = read_corners(table(text(*lines)))
    assert found.levels == ("T5", "T6") and np.array_equal(found.corners[0], QUAD)


def test_shares_of_an_images_size_are_no_pixels(table):
    levels, corners = stack()
    shares = corners / np.array([755.0, 2125.0])
    lines = [f"a,{lv},{c},{x},{y}" for lv, quad in zip(levels, shares) for c, (x, y) in zip(CORNERS, quad)]
    bad, good = read_corner_file(table(text(*lines, *rows(name="b")))).images
    assert isinstance(bad, UnreadableImage) and isinstance(good, ImageCorners)
    assert bad.reason.endswith("shares of the image's size, wanted pixels; multiply x by its columns and y by its rows")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: r[:3], "no T5 bottom_left"),
        (lambda r: [*r, r[1]], "row 6: T5 top_right is given twice"),
        (lambda r: [r[0].replace("T5", "T13"), *r[1:]], "row 2: unknown level 'T13'"),
        (lambda r: [r[0].replace("top_left", "left"), *r[1:]], "row 2: unknown corner 'left'"),
        (lambda r: ["a,T5,top_left,nan,50", *r[1:]], "row 2: x is 'nan', wanted a number"),
        (lambda r: ["a,T5,top_left,1,inf", *r[1:]], "row 2: y is 'inf', wanted a number"),
        (lambda r: ["a,T5,top_left,1_0,50", *r[1:]], "row 2: x is '1_0'"),
        (lambda r: ['a,T5,top_left,"1,5",50', *r[1:]], "row 2: x is '1,5', wanted a number .decimal point"),
        (lambda r: ["a,T5,top_left,1e999,50", *r[1:]], "row 2: x is '?1e999'?, wanted at most 100000"),
        (lambda r: ["a,T5,top_left,,50", *r[1:]], "row 2: x is ''"),
    ],
)
def test_a_fault_of_one_image_leaves_the_others(table, change, words):
    path = table(text(*change(rows()), *rows(("T5", "T6"), "b")))
    bad, good = read_corner_file(path).images
    assert isinstance(bad, UnreadableImage) and re.search(words, bad.reason)
    assert isinstance(good, ImageCorners) and good.levels == ("T5", "T6")
    with pytest.raises(SubjectError, match=f"a: .*{words}"):
        read_corners(path)


def test_markups_come_back_as_written(tmp_path):
    path = tmp_path / "out.mrk.json"
    write_corners(path, [image("one"), image("two", unit="unstated"), image("three", unit="mm", first_on="right")])
    found = read_corners(path)
    assert [f.image for f in found] == ["one", "two", "three"]
    assert all(np.allclose(f.corners, image().corners, atol=1e-4) for f in found)
    assert [(f.unit, f.first_on) for f in found] == [("px", None), ("unstated", None), ("mm", "right")]


def markups(**changes):
    points = [{"label": f"T5 {corner}", "position": [float(x), float(y), 0.0]} for corner, (x, y) in zip(CORNERS, QUAD)]
    return {"type": "Fiducial", "name": "spine", "coordinateSystem": "LPS", "controlPoints": points, **changes}


def markups_file(tmp_path, *lists):
    path = tmp_path / "corners.mrk.json"
    path.write_text(json.dumps({"markups": lists}))
    return path


def moved(positions):
    return [{**point, "position": list(map(float, p))} for point, p in zip(markups()["controlPoints"], positions)]


def test_markups_of_slicer_are_read_in_either_system_and_plane(tmp_path):
    x, y = QUAD.T
    flat, nothing = np.zeros(4), np.full(4, 12.5)
    lists = [
        markups(),
        markups(name="ras", coordinateSystem="RAS", controlPoints=moved(np.stack([-x, -y, flat], 1))),
        markups(name="coronal", controlPoints=moved(np.stack([x, nothing, -y], 1))),
        markups(name="coronal ras", coordinateSystem="RAS", controlPoints=moved(np.stack([-x, -nothing, -y], 1))),
    ]
    found = read_corners(markups_file(tmp_path, *lists))
    assert all(np.array_equal(f.corners, QUAD[None]) for f in found)
    assert [f.first_on for f in found] == [None, None, "right", "right"]
    assert [f.unit for f in found] == ["unstated", "unstated", "mm", "mm"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"type": "Curve"}, "type: found 'Curve', wanted 'Fiducial'"),
        ({"coordinateSystem": None}, "coordinateSystem: found None, wanted 'LPS' or 'RAS'"),
        ({"coordinateUnits": "um"}, "coordinateUnits: found 'um', wanted 'mm'"),
        ({"controlPoints": []}, "wanted at least one point"),
        ({"controlPoints": [3]}, r"controlPoints\[0\]: found 3"),
        ({"controlPoints": moved(np.column_stack([QUAD, [0, 1, 2, 3]]))}, "lie in no one picture"),
        ({"controlPoints": moved(np.zeros((4, 3)))}, "lie in no one picture"),
        ({"controlPoints": moved(np.zeros((4, 2)))}, "position: found .* wanted three finite numbers"),
        ({"controlPoints": [{"label": "T5", "position": [1, 2, True]}]}, "wanted three finite numbers"),
        ({"controlPoints": [{"label": "T5", "position": [1, 2, 10**400]}]}, "wanted three finite numbers"),
        ({"controlPoints": [{"label": "T5", "positionStatus": "undefined"}]}, "has no position"),
        ({"controlPoints": [{**p, "label": "T5"} for p in markups()["controlPoints"]]}, "point 1 'T5': unknown corner"),
        ({"controlPoints": markups()["controlPoints"][:3]}, "no T5 bottom_left"),
        ({"controlPoints": markups()["controlPoints"] + markups()["controlPoints"][:1]}, "point 5 .* given twice"),
    ],
)
def test_a_list_that_is_no_picture_of_corners_is_refused(tmp_path, changes, words):
    bad, good = read_corner_file(markups_file(tmp_path, markups(**{"name": "bad", **changes}), markups())).images
    assert isinstance(bad, UnreadableImage) and re.search(words, bad.reason), bad
    assert isinstance(good, ImageCorners)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ('{"markups": []}', "at least one point list"),
        ('{"markups": [1]}', r"markups\[0\]: found int"),
        (json.dumps({"markups": [markups(), markups()]}), "two lists are named 'spine'"),
        (json.dumps({"markups": [markups(name=""), markups()]}), r"markups\[0\].name: missing"),
        (json.dumps({"markups": [markups(name=7)]}), r"markups\[0\].name: found int"),
        ('{"markups": [NaN]}', "found NaN"),
        ("{", "not JSON"),
        ("[]", "Input should be an object|wanted an object"),
    ],
)
def test_a_json_that_holds_no_corners_is_refused(tmp_path, content, words):
    path = tmp_path / "corners.mrk.json"
    path.write_text(content)
    with pytest.raises(SubjectError) as error:
        read_corner_file(path)
    assert re.search(words, str(error.value)) and "\n" not in str(error.value)


def test_many_lists_take_as_long_as_there_are_lists(tmp_path):
    """Each name used to be compared with all before it: 15 s for this file, hours for the largest that is read."""
    path = markups_file(tmp_path, *({"name": f"image {i}"} for i in range(20_000)))
    began = time.process_time()
    assert len(read_corner_file(path).images) == 20_000
    assert time.process_time() - began < 3.0


def test_a_nameless_only_list_is_named_after_its_file(tmp_path):
    assert read_corners(markups_file(tmp_path, markups(name="")))[0].image == "corners"


@pytest.mark.parametrize("first_on", ["left", "right"])
@pytest.mark.parametrize("upright", [True, False])
def test_an_annotation_is_read_as_seen(tmp_path, first_on, upright):
    """Our order is the patient's; top and left are the image's, even where it stands on its head."""
    levels, corners = stack()
    quads = corners if first_on == "left" else corners[:, [1, 0, 3, 2]]
    if not upright:
        # The image turned by half a turn: what was first on the left is on the right now.
        quads = np.array([400.0, 400.0]) - quads
    content = {"schema_version": 1, "images": {"rest/frontal": {"vertebrae": dict(zip(levels, quads.tolist()))}}}
    path = tmp_path / "annotation.json"
    path.write_text(json.dumps(content))
    (found,) = read_corners(path)
    assert found.levels == levels
    if upright:
        assert np.array_equal(found.corners, corners)
        assert np.array_equal(found.annotation_quads(), quads)
    else:
        assert np.array_equal(found.corners, np.array([400.0, 400.0]) - corners[:, [2, 3, 0, 1]])
    assert found.first_on == (first_on if upright else {"left": "right", "right": "left"}[first_on])


def test_an_annotations_pedicles_alone_and_views_from_other_sides_are_passed_by(tmp_path):
    levels, corners = stack()
    marks = {"vertebrae": dict(zip(levels, corners.tolist()))}
    alone = {"vertebrae": {}, "pedicles": {levels[0]: [[1.0, 2.0], [3.0, 4.0]]}}
    images = {"push/main": marks, "push/main/1": alone, "push/main/0/side": marks}
    path = tmp_path / "annotation.json"
    path.write_text(json.dumps({"schema_version": 1, "images": images}))
    assert [found.image for found in read_corners(path)] == ["push/main"]


def test_an_annotation_keeps_what_is_not_written(tmp_path):
    path = tmp_path / "annotation.json"
    push = image("push/main", first_on="right")
    write_corners(path, [image("rest/frontal", first_on="right"), push])
    content = json.loads(path.read_text())
    content["images"]["push/main"]["supports"] = {"pelvis": [[1.0, 2.0]]}
    path.write_text(json.dumps(content))
    changed = ImageCorners("push/main", push.levels, push.corners + 1.0, first_on="right")
    write_corners(path, [changed])
    record = read_record(path, Annotation)
    assert set(record.images) == {"rest/frontal", "push/main"}
    assert record.images["push/main"].supports["pelvis"] == ((1.0, 2.0),)
    found = {f.image: f for f in read_corners(path)}
    assert np.array_equal(found["push/main"].corners, changed.corners)
    assert found["push/main"].first_on == "right" and not found["push/main"].lateral


@pytest.mark.parametrize(
    ("images", "name", "words"),
    [
        ([], "a.csv", "no image to write"),
        ([image(), image()], "a.csv", "the same name"),
        ([image()], "a.xlsx", "wanted a name that ends in"),
        ([image()], "annotation.json", "on which side of the image the patient's left lies is not known"),
        ([image(unit="unstated", first_on="left")], "annotation.json", "not known to be in pixels"),
        ([image(unit="unstated")], "a.csv", r"a: corners in pixels are wanted for a CSV \(unit: unstated\)"),
        ([image(unit="mm", first_on="right")], "a.csv", r"CSV \(unit: mm\); write a \.mrk\.json"),
    ],
)
def test_what_a_format_cannot_hold_is_not_written(tmp_path, images, name, words):
    with pytest.raises(SubjectError, match=words):
        write_corners(tmp_path / name, images)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("side", ["left", None])
def test_corners_in_mm_have_the_patients_left_on_the_right(side):
    """As a markups file has them: written to one and read again, a curve would change its side."""
    with pytest.raises(SubjectError, match="a: corners in mm are of LPS, with the patient's left on the right"):
        image(unit="mm", first_on=side)


def test_an_annotation_that_would_be_refused_leaves_the_old_file(tmp_path):
    path = tmp_path / "annotation.json"
    write_corners(path, [image("rest/frontal", first_on="right")])
    before = path.read_bytes()
    few = ImageCorners("rest/frontal", VERTEBRAE[:2], QUAD + np.array([[[0, 0]], [[0, 30]]]), first_on="right")
    with pytest.raises(SubjectError, match=r"not written: images: rest/frontal.vertebrae: found 2 vertebrae"):
        write_corners(path, [few])
    assert path.read_bytes() == before
    path.write_text("[]")
    with pytest.raises(SubjectError, match="holds no annotation"):
        write_corners(path, [image("rest/frontal", first_on="right")])
    assert path.read_text() == "[]"
    path.write_text('{"schema_version": 1, "images": {"rest/frontal": null}}')
    with pytest.raises(SubjectError, match=r"images\.rest/frontal: holds no annotation; it is left"):
        write_corners(path, [image("rest/frontal", first_on="right")])
    assert "null" in path.read_text()


@pytest.mark.parametrize(
    ("levels", "corners", "words"),
    [
        (("T5",), [QUAD * np.nan], "not finite"),
        (("T5",), [QUAD * 1e6], "more than 100000"),
        (("T5", "T5"), [QUAD, QUAD], "T5 is given twice"),
        (("C7",), [QUAD], "unknown level 'C7'"),
        (("T5", "T6"), [QUAD], "shape"),
        ((), np.zeros((0, 4, 2)), "no vertebra"),
    ],
)
def test_corners_are_checked_when_made(levels, corners, words):
    with pytest.raises(SubjectError, match=words):
        ImageCorners("a", levels, corners)


def test_files_of_other_kinds_and_sizes_are_refused(tmp_path, monkeypatch):
    with pytest.raises(SubjectError, match=r"wanted a .csv, a .mrk.json or an annotation.json"):
        read_corner_file(tmp_path / "corners.xlsx")
    with pytest.raises(SubjectError, match="no such file"):
        read_corner_file(tmp_path / "corners.csv")
    path = tmp_path / "large.csv"
    write_corners(path, [image()])
    monkeypatch.setattr("spinestiff.curves.corner_files.LARGEST_CSV", 100)
    with pytest.raises(SubjectError, match="at most 100 bytes are read"):
        read_corner_file(path)
    monkeypatch.undo()
    monkeypatch.setattr("spinestiff.curves.corner_files.MOST_IMAGES", 1)
    write_corners(path, [image("a"), image("b")])
    with pytest.raises(SubjectError, match="more than 1 images"):
        read_corner_file(path)
    with pytest.raises(SubjectError, match="more than 1 images"):
        read_corner_file(markups_file(tmp_path, markups(), markups(name="another")))


@pytest.mark.parametrize("coding", ["utf-16", "cp1252"])
def test_a_table_is_read_in_the_codings_of_spreadsheets(table, coding):
    rows = (f"Rücken,T5,{corner},{x},{y}" for corner, x, y in zip(CORNERS, (1, 9, 9, 1), (1, 1, 9, 9)))
    (found,) = read_corner_file(table(text(*rows).encode(coding))).images
    assert (found.image, found.levels) == ("Rücken", ("T5",))


def test_an_unknown_side_is_told_with_the_way_to_state_it():
    found = ImageCorners("a", ("T5",), np.array([[[1, 1], [9, 1], [9, 9], [1, 9]]]))
    with pytest.raises(SubjectError, match=r'state it \(dataclasses.replace with first_on="left" or "right"\)'):
        found.annotation_quads()
    assert replace(found, first_on="right").annotation_quads().shape == (1, 4, 2)
