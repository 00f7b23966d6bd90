"""A subject that is there already, in a headless Chromium: more radiographs with pictures, views, priors."""

from __future__ import annotations

import sys

import pydicom
import pytest

from bench_page import box, chosen, click, files, fill, go, load, text
from chromium import browser
from hospital import export, gauged
from spinestiff.files import read_json

pytestmark = pytest.mark.skipif(
    browser() is None or sys.platform == "win32", reason="no Chromium to open the page in, or no pipe to drive it by"
)
SHOWN = "document.querySelectorAll('canvas.thumb[data-state=shown]').length"
# Pictures whose pixels differ from each other: nothing black, nothing empty.
DRAWN = """[...document.querySelectorAll('canvas.thumb')].filter(one => {
  const seen = new Set(one.getContext('2d').getImageData(0, 0, one.width, one.height).data);
  return seen.size > 50 && one.width <= 96 && one.height <= 128;
}).length"""
SAVED = "document.querySelector('.saved').innerText.startsWith('Saved')"


def open_xray(tab, served):
    """The X-ray geometry in the values of the one subject."""
    load(tab, served.address)
    go(tab, f"/subject/{served.key()}/values")
    tab.run("(document.querySelector('#xray').open = true, 1)")


def test_more_radiographs_and_a_view_for_a_subject_that_is_there(tab, root, serve, tmp_path):
    (root / "girl" / "rest" / "lateral.dcm").unlink()
    export(tmp_path / "more" / "I2", "lateral", patient="", time="103000")
    export(tmp_path / "more" / "I3", "lateral", patient="", time="103300")
    export(tmp_path / "more" / "I8", frames=2, patient="", time="104000")
    before = read_json(root / "girl" / "subject.json")
    with serve(root) as served:
        load(tab, served.address)
        click(tab, "h2 a")
        click(tab, ".way a[href$='/radiographs']")
        tab.until(f"{SHOWN} == 2")
        assert tab.run(DRAWN) == 2 and "push a" in text(tab, "tbody")
        files(tab, "#files", sorted((tmp_path / "more").iterdir()))
        tab.until("!!document.querySelector('#add')")
        tab.run("(document.querySelector('#add').scrollIntoView(), 1)")
        tab.until(f"{SHOWN} == 5")
        assert tab.run(DRAWN) == 5
        assert text(tab, "#changes").split("\n") == ["A lateral radiograph at rest.", "Push-2, 2 frames."]
        # The other lateral one shows the push from the side, in its last frame.
        tab.run("(document.querySelector('#add-view').closest('details').open = true, 1)")
        click(tab, "#room input[type=checkbox][value='I3']")
        fill(tab, "#view-frames", "7")
        click(tab, "#add-view")
        tab.until("document.querySelector('#problem').innerText.includes('found frame 7')")
        fill(tab, "#view-frames", "2")
        click(tab, "#add-view")
        tab.until("document.querySelector('tbody').innerText.includes('push a, view side')")
        click(tab, "#add")
        tab.until("document.querySelector('[role=status]:not([id])').innerText.startsWith('Added')")
        tab.until(f"{SHOWN} == 5")
        go(tab, f"/subject/{served.key()}/values")
        legends = tab.run("[...document.querySelectorAll('.push legend')].map(one => one.textContent)")
        assert legends == ["Push a", "Push-2"]
        # The refused view, and that this test reads the canvases.
        assert all("422" in line or "getImageData" in line for line in tab.complaints)
    values = read_json(root / "girl" / "subject.json")
    view = {"id": "side", "kind": "lateral", "frames": [2], "files": "pushes/a-side.dcm"}
    assert values["pushes"][0] == {**before["pushes"][0], "views": [view]} and values["pushes"][1]["id"] == "push-2"
    assert (root / "girl" / "rest" / "lateral.dcm").read_bytes() == (tmp_path / "more" / "I2").read_bytes()


def test_a_rest_radiograph_is_replaced_and_taken_back(tab, root, serve, tmp_path):
    lateral = export(tmp_path / "I2", "lateral", patient="", time="103000")
    new = export(tmp_path / "I9", patient="", time="114500")
    place = root / "girl" / "rest" / "frontal.dcm"
    before = place.read_bytes()
    with serve(root) as served:
        load(tab, served.address)
        go(tab, f"/subject/{served.key()}/radiographs")
        click(tab, "[aria-label='Replace …: the frontal radiograph at rest']")
        tab.until("document.querySelector('h2').innerText.includes('in place of the frontal radiograph')")
        files(tab, "#files", [lateral])
        tab.until("document.querySelector('#room').innerText.includes('None of these files can take its place')")
        files(tab, "#files", [new])
        tab.until("!!document.querySelector('#replace')")
        assert "rest/frontal.dcm moves to the trash" in text(tab, "#changes") and place.read_bytes() == before
        tab.run("(document.querySelector('#replace').scrollIntoView(), 1)")
        tab.until("document.querySelectorAll('.swap canvas[data-state=shown]').length == 2")
        assert tab.run(DRAWN.replace("canvas.thumb'", ".swap canvas'")) == 2
        click(tab, "#replace")
        tab.until("document.querySelector('[role=status]:not([id])').innerText.includes('has to be annotated')")
        assert place.read_bytes() == new.read_bytes()
        click(tab, "#undo button")
        tab.until("document.querySelector('[role=status]:not([id])').innerText.includes('is back, with its marks')")
        assert place.read_bytes() == before
        go(tab, "/trash")
        assert "girl: frontal radiograph at rest" in text(tab)


def test_a_table_for_a_push_that_is_there(tab, root, serve, tmp_path):
    table = tmp_path / "pushes.csv"
    table.write_text("file,frame,force_n,side,level,d21_mm,d31_mm\nno.dcm,1,25,,,,\n", encoding="utf-8")
    with serve(root) as served:
        load(tab, served.address)
        go(tab, f"/subject/{served.key()}/radiographs")
        files(tab, "#table", [table])
        tab.until("document.querySelector('#problem').innerText.includes(\"no radiograph 'no.dcm'\")")
        right = tmp_path / "right.csv"
        right.write_text("file,frame,force_n,side,level,d21_mm,d31_mm\na.dcm,1,25,,,,\n", encoding="utf-8")
        files(tab, "#table", [right])
        tab.until("!!document.querySelector('#nothing-new')")
        assert "push a, frame 1: stays 20 N, the table has 25 N" in text(tab)


def test_trunk_scan_and_ratios_are_filled_in(tab, root, serve, tmp_path):
    scan = tmp_path / "back.obj"
    scan.write_bytes(box(280.0, 190.0, 450.0))
    place = root / "girl" / "subject.json"
    with serve(root) as served:
        load(tab, served.address)
        go(tab, f"/subject/{served.key()}/values")
        tab.run("(document.querySelectorAll('#room details').forEach(one => { one.open = true; }), 1)")
        click(tab, "#trunk-add")
        fill(tab, "#f-trunk-T9-breadth-mm", "245")
        tab.until("document.querySelector('#f-trunk-T9-depth-mm-says').innerText == 'missing'")
        fill(tab, "#f-trunk-T9-depth-mm", "172")
        tab.until("document.querySelector('.saved').innerText.startsWith('Saved')")
        assert read_json(place)["trunk"] == {"T9": {"breadth_mm": 245, "depth_mm": 172}}
        click(tab, "#ratios-choose")
        chosen(tab, "#ratio-0-at", "between")
        chosen(tab, "#ratio-0-0", "T5")
        click(tab, "#ratios-add")
        chosen(tab, "#ratio-2-of", "tissue")
        tab.until("document.querySelector('#f-parameters-says').innerText.includes('named twice')")
        chosen(tab, "#ratio-2-at", "abdomen")
        chosen(tab, "#f-population", "koutras2025")
        tab.until("document.querySelector('.saved').innerText.startsWith('Saved')")
        values = read_json(place)
        assert values["parameters"] == ["lateral_bending@T5-T9", "tissue", "tissue@abdomen"]
        assert values["population"] == "koutras2025"
        click(tab, "#ratios-usual")
        tab.wait(lambda: "parameters" not in read_json(place))
        tab.run("(document.querySelector('#skin').open = true, 1)")
        files(tab, "#skin-file", [scan])
        for name, value in {"unit": "cm", "axes-left": "+x", "axes-up": "+z", "axes-front": "-y"}.items():
            chosen(tab, f"#f-skin-scan-{name}", value)
        click(tab, "#skin-add")
        tab.until("document.querySelector('#problem').innerText.includes('check unit (cm) and axes')")
        chosen(tab, "#f-skin-scan-unit", "mm")
        click(tab, "#skin-add")
        tab.until("document.querySelector('#skin summary').innerText.includes('skin-scan.obj')")
        assert read_json(place)["skin_scan"]["unit"] == "mm"


def test_views_markers_and_priors_are_checked_as_one_types(tab, root, serve, tmp_path):
    table = tmp_path / "markers.csv"
    rows = [f"{name},{frame},1,2,3" for name in "abc" for frame in range(3)]
    table.write_text("\n".join(["marker,frame,x,y,z", *rows]), encoding="utf-8")
    with serve(root) as served:
        load(tab, served.address)
        go(tab, f"/subject/{served.key()}/values")
        tab.run("(document.querySelectorAll('#room details').forEach(one => { one.open = true; }), 1)")
        files(tab, "#markers-0-file", [table])
        axes = {"unit": "mm", "axes-left": "+x", "axes-up": "+z", "axes-front": "-y", "side": "front"}
        for name, value in axes.items():
            choose = f"e.value = '{value}', e.dispatchEvent(new Event('change')), 1"
            tab.run(f"(e => ({choose}))(document.getElementById('f-pushes-0--markers-{name}'))")
        fill(tab, "#f-pushes-0--markers-shown", "d, 20, 30.5")
        click(tab, "#markers-0-add")
        tab.until("document.querySelector('#problem').innerText.includes(\"no marker 'd'\")")
        fill(tab, "#f-pushes-0--markers-shown", "a, 20, 30.5")
        click(tab, "#markers-0-add")
        tab.until("document.querySelector('#room').innerText.includes('pushes/a-markers.csv')")
        markers = {"file": "pushes/a-markers.csv", "unit": "mm", "side": "front", "shown": {"a": [20, 30.5]}}
        markers["axes"] = {"left": "+x", "up": "+z", "front": "-y"}
        assert read_json(root / "girl" / "subject.json")["pushes"][0]["markers"] == markers
        # What is impossible is said where it stands, and not saved.
        for field, bad, words in (
            ("pushes-0--markers-shown", "a, 20", "wanted"),
            ("priors-force-scale", "-1", "greater than or equal to 0"),
        ):
            tab.run("(document.querySelectorAll('#room details').forEach(one => { one.open = true; }), 1)")
            before = tab.run(f"document.getElementById('f-{field}').value")
            fill(tab, f"#f-{field}", bad)
            tab.until("document.querySelector('.saved').innerText.startsWith('Not saved')")
            assert words in text(tab, f"#f-{field}-says")
            fill(tab, f"#f-{field}", before or "0.005")
            tab.until("document.querySelector('.saved').innerText.startsWith('Saved')")
        assert read_json(root / "girl" / "subject.json")["priors"] == {"force_scale": 0.005}
        assert "Usually 0.02." in text(tab, "[data-field='priors.force_scale']")
        fill(tab, "#f-priors-frame-obliquity-deg", "9")
        tab.until("document.querySelector('#f-priors-says').innerText.includes('is a part of obliquity_deg')")
        tab.run("(document.querySelector('#f-priors-frame-obliquity-deg').value = '', 1)")
        fill(tab, "#f-priors-force-scale", "0.5")
        tab.run("(e => (e.value = '', e.dispatchEvent(new Event('input')), 1))"
                "(document.querySelector('#f-priors-frame-obliquity-deg'))")  # fmt: skip
        tab.until("document.querySelector('.saved').innerText.startsWith('Saved')")
        button = "[...document.querySelectorAll('button')].find(one => one.innerText == 'Take the markers out')"
        tab.run(f"({button}.click(), 1)")
        tab.until("document.querySelector('.saved').innerText.startsWith('Saved')")
        tab.until("!document.querySelector('#room').innerText.includes('pushes/a-markers.csv')")
        assert read_json(root / "girl" / "subject.json")["priors"] == {"force_scale": 0.5}
        tab.wait(lambda: "markers" not in read_json(root / "girl" / "subject.json")["pushes"][0])
        click(tab, "#undo-values")
        tab.wait(lambda: read_json(root / "girl" / "subject.json")["pushes"][0].get("markers") == markers)


def test_a_known_length_is_typed_or_clicked_in_the_picture(tab, root, serve):
    place = root / "girl" / "subject.json"
    with serve(root) as served:
        open_xray(tab, served)
        click(tab, "#scale-add")
        assert "scale" not in read_json(place).get("xray", {})
        fill(tab, "#f-xray-scale-rest-frontal-object-mm", "25.4")
        tab.until("document.querySelector('#f-xray-scale-rest-frontal-says').innerText.includes('both ends')")
        assert tab.run("document.querySelector('.beam .t-on').textContent") == "object 25.4 mm"
        fill(tab, "#f-xray-scale-rest-frontal-object-px", "100, 200\n180.5; 200")
        tab.until(SAVED)
        length = {"object_mm": 25.4, "object_px": [[100, 200], [180.5, 200]]}
        assert read_json(place)["xray"]["scale"] == {"rest/frontal": length}
        # The same by clicks: near the end, then exactly.
        click(tab, ".pick")
        tab.until("document.querySelector('.picked').innerText.startsWith('First end')")

        def press(selector, along):
            tab.run(f"(document.querySelector('{selector}').scrollIntoView({{block: 'center'}}), 1)")
            at = f"r => [r.x + r.width * {along}, r.y + r.height / 2]"
            point = tuple(tab.run(f"({at})(document.querySelector('{selector}').getBoundingClientRect())"))
            tab.drag(point, point)

        # A slow machine: the enlarged part of before is no longer there to be clicked in.
        tab.run(
            "(window.fetch = (f => (...a) => new Promise(r => setTimeout(() => r(f(...a)), 400)))(window.fetch), 1)"
        )
        for along in (0.25, 0.5):
            press(".ends", along)
            tab.until("!document.querySelector('.near').hidden")
            press(".ends.near", 0.5)
        tab.until(SAVED)
        was = length["object_px"]
        tab.wait(lambda: not any(end in was for end in read_json(place)["xray"]["scale"]["rest/frontal"]["object_px"]))
        (one, other) = read_json(place)["xray"]["scale"]["rest/frontal"]["object_px"]
        # The picture has 448 columns and 640 rows; the enlarged part begins at a whole pixel.
        assert abs(one[0] - 111.5) < 2.5 and abs(other[0] - 223.5) < 2.5 and abs(one[1] - 319.5) < 2.5
        chosen(tab, "#scale-image", "push/a")
        chosen(tab, "#scale-kind", "vertebra")
        click(tab, "#scale-add")
        chosen(tab, "#f-xray-scale-push-a-vertebra", "L1")
        fill(tab, "#f-xray-scale-push-a-width-mm", "42")
        tab.wait(lambda: read_json(place)["xray"]["scale"].get("push/a") == {"vertebra": "L1", "width_mm": 42})
        click(tab, "[data-scale='rest/frontal'] > button")
        tab.wait(lambda: set(read_json(place)["xray"]["scale"]) == {"push/a"})
        tab.until(SAVED)
        click(tab, "#undo-values")
        tab.wait(lambda: set(read_json(place)["xray"]["scale"]) == {"push/a", "rest/frontal"})


def test_a_picture_of_another_system_has_its_own_distances(tab, root, serve):
    place = root / "girl" / "subject.json"
    with serve(root) as served:
        open_xray(tab, served)
        fill(tab, "#f-xray-source-patient-mm", "1340")
        chosen(tab, "#apart-image", "rest/lateral")
        click(tab, "#apart-add")
        assert "images" not in read_json(place).get("xray", {})
        fill(tab, "#f-xray-images-rest-lateral-source-detector-mm", "18300")
        tab.until(
            "document.querySelector('#f-xray-images-rest-lateral-source-detector-mm-says').innerText.includes('10000')"
        )
        fill(tab, "#f-xray-images-rest-lateral-source-detector-mm", "1830")
        tab.until(SAVED)
        tab.wait(lambda: read_json(place)["xray"].get("images") == {"rest/lateral": {"source_detector_mm": 1830}})
        # The picture of the rays shows this radiograph's own distance, and what holds for all.
        shown = tab.run("document.querySelector('.beam').textContent")
        assert "to the detector 1830 mm" in shown and "to the patient 1340 mm" in shown
        click(tab, "[data-apart='rest/lateral'] > button")
        tab.wait(lambda: "images" not in read_json(place)["xray"])
        click(tab, "#undo-values")
        tab.wait(lambda: read_json(place)["xray"].get("images") == {"rest/lateral": {"source_detector_mm": 1830}})
        assert tab.complaints == []


def test_single_pictures_are_marked_and_made_one_push(tab, root, serve, tmp_path):
    for name, time in (("I1", "101000"), ("I2", "104500"), ("I3", "103000"), ("I4", "103500")):
        export(tmp_path / "in" / name, time=time, patient="")
    uses = "[...document.querySelectorAll('tbody b')].map(one => one.innerText).join()"
    before = "rest, frontal,left out,left out,left out"
    with serve(root) as served:
        load(tab, served.address)
        go(tab, "/new")
        files(tab, "#files", sorted((tmp_path / "in").iterdir()))
        tab.until("!!document.querySelector('#join')")
        assert tab.run(uses) == before and "mark it with the others of that push" in text(tab, "tbody")
        click(tab, "#join")
        tab.until("document.querySelector('#problem').innerText.includes('mark two or more')")
        for name in ("I2", "I3", "I4"):
            click(tab, f"input[type=checkbox][value='{name}']")
        click(tab, "#join")
        tab.until("!!document.querySelector('#joined [aria-label]')")
        assert tab.run(uses) == "rest, frontal,push 1, frame 0,push 1, frame 1,push 1, frame 2"
        assert "One push of 3 pictures, from the first frame on: I3, I4, I2" in text(tab, "#joined")
        click(tab, "#undo button")
        tab.until(f"{uses} == '{before}'")
        for name in ("I2", "I3"):
            click(tab, f"input[type=checkbox][value='{name}']")
        click(tab, "#join")
        tab.until("document.querySelector('#joined').innerText.includes('I3, I2')")
        click(tab, "#joined [aria-label]")
        tab.until(f"{uses} == '{before}'")
        for name in ("I2", "I3"):
            click(tab, f"input[type=checkbox][value='{name}']")
        click(tab, "#join")
        tab.until("document.querySelector('#joined').innerText.includes('I3, I2')")
        fill(tab, "#name", "girl-05")
        click(tab, "#make")
        tab.until("!!document.querySelector('#f-age')")
        assert tab.run("document.querySelector('#undo').hidden")
        assert len(read_json(root / "girl-05" / "subject.json")["pushes"][0]["forces_n"]) == 2
        assert tab.complaints == []


def test_radiographs_without_millimetres_are_shown_and_what_they_lack_is_said(tab, root, serve):
    path = root / "girl" / "rest" / "frontal.dcm"
    dataset = pydicom.dcmread(path)
    del dataset.ImagerPixelSpacing
    dataset.save_as(path)
    with serve(root) as served:
        load(tab, served.address)
        go(tab, f"/subject/{served.key()}/radiographs")
        tab.until(f"{SHOWN} == 3")
        assert "rest, frontal: no ImagerPixelSpacing" in text(tab, "#lacking")
        click(tab, "#lacking a")
        tab.until("!!document.querySelector('#xray')")


@pytest.mark.parametrize("encoding", ["utf-16", "cp1252"])
def test_a_log_with_times_of_day_and_letters_of_its_own_gives_the_forces(tab, root, serve, tmp_path, encoding):
    true = gauged(tmp_path)
    rows = [row.split(";") for row in (tmp_path / "gauge.csv").read_text(encoding="utf-8").splitlines()[1:]]
    clocked = [f"14:{int(ms) // 60000:02d}:{int(ms) / 1000 % 60:06.3f};{force}" for ms, force in rows]
    log = tmp_path / "Prüfung.csv"
    log.write_text("\n".join(["Gerät µ", "Zeit (h:mm:ss);Kraft (kgf)", *clocked]), encoding=encoding)
    with serve(root, sources=(tmp_path / "in",)) as served:
        made = {
            "origin": "source",
            "key": served.good("GET", "/api/sources")["sources"][0]["key"],
            "name": "new",
            "person": {},
        }
        key = served.good("POST", "/api/subjects", made)["key"]
        load(tab, served.address)
        go(tab, f"/subject/{key}/form")
        tab.run("(document.querySelector('#log-0-file').closest('details').open = true, 1)")
        micro = tmp_path / "micro.csv"
        micro.write_text("Zeit (µs);Kraft (N)\n0;0\n1;2\n", encoding=encoding)
        files(tab, "#log-0-file", [micro])
        click(tab, "#log-0-read")
        tab.until("document.querySelector('#problem').innerText.includes('is in μs; convert it')")
        files(tab, "#log-0-file", [log])
        click(tab, "#log-0-read")
        tab.until("document.querySelector('#room').innerText.includes('(times of day)')")
        shown = text(tab)
        assert "Kraft (kgf)" in shown and "count from its first entry, 14:00:00.000" in shown
        click(tab, "#room details[open] button.main")
        tab.until("document.querySelector('.saved').innerText.startsWith('Saved')")
        assert len(tab.complaints) == 1 and "422" in tab.complaints[0]
    forces = read_json(root / "new" / "subject.json")["pushes"][0]["forces_n"]
    assert max(abs(one - other) for one, other in zip(forces, true, strict=True)) < 2.5


def test_a_log_without_times_gives_the_forces_by_its_entries_a_second(tab, root, serve, tmp_path):
    true = gauged(tmp_path)
    rows = (tmp_path / "gauge.csv").read_text(encoding="utf-8").splitlines()[1:]
    log = tmp_path / "numbered.csv"
    log.write_text("\n".join(["Nr;Kraft (kgf)", *(f"{i};{row.split(';')[1]}" for i, row in enumerate(rows))]))
    with serve(root, sources=(tmp_path / "in",)) as served:
        source = served.good("GET", "/api/sources")["sources"][0]["key"]
        made = {"origin": "source", "key": source, "name": "new", "person": {}}
        key = served.good("POST", "/api/subjects", made)["key"]
        load(tab, served.address)
        go(tab, f"/subject/{key}/form")
        tab.run("(document.querySelector('#log-0-file').closest('details').open = true, 1)")
        files(tab, "#log-0-file", [log])
        click(tab, "#log-0-read")
        tab.until("document.querySelector('#problem').innerText.includes('give its entries a second')")
        fill(tab, "#log-0-rate", "50")
        click(tab, "#log-0-read")
        tab.until("document.querySelector('#room').innerText.includes('50 a second')")
        click(tab, "#room details[open] button.main")
        tab.until("document.querySelector('.saved').innerText.startsWith('Saved')")
    forces = read_json(root / "new" / "subject.json")["pushes"][0]["forces_n"]
    assert max(abs(one - other) for one, other in zip(forces, true, strict=True)) < 2.5
