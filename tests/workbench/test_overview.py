"""All subjects in a table, with the change of the Cobb angle; two visits of one person compared."""

from __future__ import annotations

import csv
import io
import json
import re
import shutil
import sys
from dataclasses import asdict, replace
from types import SimpleNamespace

import pytest

from bench_page import click, go, load, text
from chromium import browser
from spinestiff.files import read_json, write_json
from spinestiff.study.repeatability import VisitEstimate, VisitRatio, estimate_of, repeatability
from spinestiff.study.report.clinician import stiffness
from spinestiff.study.visit import open_visit
from spinestiff.study.wording.estimate import told_stiffness
from spinestiff.study.wording.repeat import repeatability_lines
from spinestiff.study.wording.titles import RATIO_TITLES, TIMES_DEFAULT, TIMES_WHOLE
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.folder import read_unannotated
from spinestiff.subject.outcomes import Responses
from spinestiff.subject.run_record import read_outcome
from spinestiff.workbench import cards
from spinestiff.workbench import visits as compared
from spinestiff.workbench.overview import overview_csv

HAS_BROWSER = browser() is not None and sys.platform != "win32"
STIFFNESS = {"name": "tissue", "unit": TIMES_DEFAULT, "value": 0.5, "low": 0.4, "high": None, "open_low": False,
             "open_high": True}  # fmt: skip


@pytest.fixture(scope="module")
def visits(finished, tmp_path_factory):
    """Two visits of one person; only to be read."""
    root = tmp_path_factory.mktemp("visits") / "root"
    for name in ("first", "second"):
        shutil.copytree(finished.folder, root / name)
    return root


@pytest.fixture
def taken_anew(monkeypatch):
    """``estimate_of`` to which copies of a folder are visits with radiographs of their own."""

    def own(visit):
        return replace(estimate_of(visit), push_pictures=frozenset({visit.subject.folder.name}))

    monkeypatch.setattr(compared, "estimate_of", own)
    return own


def rows_of(content):
    return list(csv.DictReader(io.StringIO(content)))


def test_the_table_has_stiffness_and_the_change_of_the_cobb_angle(visits, serve):
    with serve(visits, read_only=True) as served:
        status, headers, content = served.ask("GET", "/api/table.csv")
        assert status == 200 and headers["content-type"].startswith("text/csv")
        rows = rows_of(content.decode())
        card = served.good("GET", f"/api/subjects/{served.key('first')}")
    responses = read_outcome(read_unannotated(visits / "first"), Responses)
    push, found = max(responses.pushes.items(), key=lambda one: one[1].force_n)
    assert [row["subject"] for row in rows] == ["first", "second"]
    row, cobb = rows[0], card["result"]["cobb"]
    assert (row["cobb_push"], float(row["cobb_force_n"])) == (push, found.force_n)
    assert float(row["cobb_change_deg"]) == found.curve.change_deg == cobb["change_deg"]
    assert float(row["cobb_change_half_width95_deg"]) == pytest.approx(1.96 * found.curve.change_sd_deg)
    assert f"± {1.96 * found.curve.change_sd_deg:.1f}°" in cobb["words"] and "under" in cobb["words"]
    for one in card["result"]["stiffness"]:
        name = next(key for key in row if key.startswith(one["name"]) and not key.endswith(("95", "_open")))
        assert float(row[name]) == one["value"]
    # The subject of the tests is estimated on the coarse mesh.
    *lines, quick = card["result"]["lines"]
    assert quick.startswith("A quick look, on a coarse mesh") and row["result"].endswith(", quick look")
    for line, one in zip(lines, card["result"]["stiffness"], strict=True):
        # One number has the same digits wherever it stands.
        ends = re.findall(r"[\d.]+", one["interval"])
        assert line.startswith(one["title"]) and len(ends) == 2 and all(f" {end} " in line for end in ends)


def test_cards_and_report_name_a_stiffness_alike(finished):
    subject = read_unannotated(finished.folder)
    estimate = read_outcome(subject, Estimate)
    reported = [stiffness(estimate, *one)["title"] for one in told_stiffness(estimate)]
    assert [one["title"] for one in cards.result(subject)["stiffness"]] == reported
    assert "Lateral bending of a thoracic level" in reported


def test_an_end_that_the_radiographs_leave_open_is_told_as_open(finished, monkeypatch):
    estimate = read_outcome(read_unannotated(finished.folder), Estimate)
    plain = {name: one.model_copy(update={"open_low": True}) for name, one in estimate.plain.items()}
    opened = estimate.model_copy(update={"plain": plain})
    monkeypatch.setattr(cards, "read_outcome", lambda at, kind: opened if kind is Estimate else read_outcome(at, kind))
    told = cards.result(read_unannotated(finished.folder))["stiffness"]
    assert told and all(one["interval"].startswith("≤ ") and "≤" not in one["interval"][2:] for one in told)


def test_a_result_that_was_changed_by_hand_is_a_problem_in_plain_words(subject):
    path = subject / "results" / "estimate.json"
    path.write_text(path.read_text(encoding="utf-8").replace("{", "{ ", 1), encoding="utf-8")
    problem = cards.result(read_unannotated(subject))["problem"]
    assert problem.endswith("; run it again") and str(subject) not in problem


def test_cells_say_what_is_open_and_are_no_formulas():
    cards = [
        {"name": "=cmd()", "stage_words": "Has a result", "age": 13.0, "stale": ["values: pushes", "annotation: rest"],
         "result": {"badge": "determined", "stiffness": [STIFFNESS]}},
        {"name": "bare", "stage_words": "To be annotated", "result": None},
        {"name": "broken", "stage_words": "Has a result", "result": {"problem": "damaged"}},
    ]  # fmt: skip
    first, bare, broken = rows_of(overview_csv(cards))
    assert first["subject"] == "'=cmd()" and first["changed_since"] == "values: pushes; annotation: rest"
    assert (first["tissue_ratio"], first["tissue_ratio_low95"], first["tissue_ratio_high95"]) == ("0.5", "0.4", "")
    assert first["tissue_ratio_open"] == "high" and first["age"] == "13.0"
    part = {**STIFFNESS, "name": "axial_rotation@lumbar", "unit": TIMES_WHOLE}
    (row,) = rows_of(overview_csv([{**cards[0], "result": {"badge": "determined", "stiffness": [part]}}]))
    assert row["axial_rotation@lumbar_ratio_of_whole"] == "0.5" and "axial_rotation@lumbar_ratio" not in row
    both = [
        {**cards[0], "result": {"badge": "determined", "stiffness": [one]}}
        for one in (part, {**part, "unit": TIMES_DEFAULT, "value": 0.1})
    ]
    found = [
        [row[f"axial_rotation@lumbar_ratio{end}"] for end in ("_of_whole", "")] for row in rows_of(overview_csv(both))
    ]
    assert found == [["0.5", ""], ["", "0.1"]]
    for row in (bare, broken):
        assert {value for name, value in row.items() if name not in ("subject", "state")} == {""}


def test_a_copy_is_no_second_visit(visits, serve):
    with serve(visits, read_only=True) as served:
        told = served.good("GET", f"/api/visits/{served.key('first')}/{served.key('second')}")
    assert told["same"] and not told["lines"] and "a copy is no second visit" in told["problem"]
    assert "--" not in told["problem"] and "spinestiff" not in told["problem"]


def test_a_change_of_which_nothing_is_known_is_told_in_words_alone(monkeypatch, tmp_path):
    """The page writes numbers: an end of an interval that is infinite is none, and none can't be written."""
    first, second = (
        VisitEstimate(name, "girl", {"tissue": VisitRatio(0.1, sd, sd, known), "bending": VisitRatio(0.1, 0.2, 0.5)})
        for name, sd, known in (("first", 0.2, True), ("second", 1000.0, False))
    )
    of = {tmp_path / "first": first, tmp_path / "second": second}
    person = SimpleNamespace(record=SimpleNamespace(id="girl"))
    monkeypatch.setattr(compared, "read_unannotated", lambda folder: person)
    monkeypatch.setattr(compared, "open_visit", lambda folder: folder)
    monkeypatch.setattr(compared, "estimate_of", of.get)
    told = compared.visits_record(*of)
    assert [one["name"] for one in told["changes"]] == ["bending"]
    assert any("tissue, first to second: can't be told" in line for line in told["lines"])
    json.dumps(told, allow_nan=False)


def test_two_visits_of_one_person_are_told_as_repeat_tells_them(visits, serve, tmp_path, taken_anew):
    wanted = repeatability([taken_anew(open_visit(visits / name)) for name in ("first", "second")])
    with serve(visits, read_only=True) as served:
        first, second = served.key("first"), served.key("second")
        told = served.good("GET", f"/api/visits/{first}/{second}")
        assert told["same"] and told["problem"] == "" and told["lines"] == repeatability_lines(wanted)
        assert told["scatter"] == {name: asdict(one) for name, one in wanted.scatter.items()}
        assert {one["title"] for one in told["changes"]} <= set(RATIO_TITLES.values())
        assert [(one["name"], one["verdict"]) for one in told["changes"]] == [
            (one.name, one.verdict) for one in wanted.changes
        ]
        assert served.good("GET", f"/api/visits/{first}/{first}")["same"] is False
    other = tmp_path / "other"
    shutil.copytree(visits, other)
    values = read_json(other / "second" / "subject.json")
    for change, same, words in (
        ({"pelvis": "level" if values.get("pelvis") != "level" else "hinge"}, True, "run it again"),
        ({"id": "somebody-else"}, False, ""),
    ):
        write_json(other / "second" / "subject.json", values | change)
        with serve(other, read_only=True) as served:
            told = served.good("GET", f"/api/visits/{served.key('first')}/{served.key('second')}")
        assert told["same"] is same and words in told["problem"] and not told["lines"], told
        assert str(other) not in told["problem"]


@pytest.mark.usefixtures("taken_anew")
@pytest.mark.skipif(not HAS_BROWSER, reason="no Chromium to open the page in, or no pipe to drive it by")
def test_the_page_downloads_the_table_and_says_whether_somebody_changed(tab, visits, serve):
    with serve(visits, read_only=True) as served:
        load(tab, served.address)
        go(tab, "/table")
        assert (
            tab.run("[...document.querySelectorAll('tbody td')].filter(one => one.innerText.includes('±')).length") == 2
        )
        tab.run("""(URL.createObjectURL = blob => (blob.text().then(text => { window.given = text; }), 'blob:none'),
          HTMLAnchorElement.prototype.click = function () { window.named = this.download; }, 1)""")
        click(tab, "#table-csv")
        tab.until("window.given?.startsWith('subject,id,state')")
        assert tab.run("named") == "subjects.csv" and len(rows_of(tab.run("given"))) == 2
        go(tab, "/compare")
        tab.until("!!document.querySelector('#change table')")
        assert "One person, two visits" in text(tab) and "no change shown" in text(tab, "#change")
        assert "would not show" in text(tab, "#change ul")
        assert tab.complaints == []
