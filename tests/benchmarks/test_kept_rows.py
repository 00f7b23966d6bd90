"""Rows that campaigns keep, and the figure that the package took from one of them."""

from __future__ import annotations

import json

import pytest

from programs import benchmark
from spinestiff.estimation.discrepancy_data import STANCE_MM

rows = benchmark("kept_rows")
stance = benchmark("discrepancy_stance")


def test_a_campaign_goes_on_where_it_was(tmp_path) -> None:
    log = tmp_path / "log.jsonl"
    assert rows.begun(log) == []
    rows.keep(log, {"seed": 1})
    rows.keep(log, {"seed": 2})
    assert rows.begun(log) == rows.rows_of([log]) == [{"seed": 1}, {"seed": 2}]
    with pytest.raises(FileNotFoundError):
        rows.rows_of([tmp_path / "none"])


@pytest.mark.parametrize("torn", ['{"seed": 2, "z": [0.', '{"seed": 2, "z": {"a": 1}'])
def test_a_row_that_was_not_written_whole_is_left_out_and_made_again(tmp_path, torn) -> None:
    """As a kill or a full disk leaves it, also where what is there of it ends with a bracket."""
    pairs = benchmark("discrepancy_pairs")
    first = {"subject": 1, "kind": "body", "draw": 0}
    for read, begin in ((rows.begun, rows.prepare), (pairs.read, lambda log: pairs.run(log, 0, 0))):
        log = tmp_path / "log.jsonl"
        log.write_text(json.dumps(first) + "\n" + torn, encoding="utf-8")
        assert read(log) == [first]
        begin(log)
        rows.keep(log, {"seed": 2})
        assert read(log) == [first, {"seed": 2}]


def test_a_summary_is_printed_and_stored_where_asked(tmp_path, capsys) -> None:
    rows.tell({"people": 3}, None)
    assert json.loads(capsys.readouterr().out)["people"] == 3
    rows.tell({"people": 4}, tmp_path / "found.json")
    assert (tmp_path / "found.json").read_text() == capsys.readouterr().out


def test_a_campaign_is_run_summed_up_or_printed(tmp_path, monkeypatch, capsys) -> None:
    log, stored = tmp_path / "log.jsonl", tmp_path / "found.json"
    rows.keep(log, {"seed": 1})

    def asked(*words):
        monkeypatch.setattr("sys.argv", ["program", *map(str, words)])
        return rows.asked_for("What it does.", stored, lambda found: {"people": len(found)}, first=7, people=40)

    given = asked("--log", log, "--people", 3)
    assert (given.log, given.first, given.people) == (log, 7, 3)
    assert asked("--json") is None and capsys.readouterr().out == "{}\n"
    assert asked("--summary", log) is None and not stored.exists()
    assert asked("--summary", log, log, "--write") is None and json.loads(stored.read_text())["people"] == 2
    capsys.readouterr()
    assert asked("--json") is None and json.loads(capsys.readouterr().out)["people"] == 2
    with pytest.raises(SystemExit):
        asked()
    assert "wanted --log FILE" in capsys.readouterr().err


def test_a_log_that_can_not_be_written_ends_a_campaign_in_one_line_before_it_begins(tmp_path, monkeypatch) -> None:
    (tmp_path / "file").write_text("no folder", encoding="utf-8")
    log, stored = tmp_path / "file" / "log.jsonl", tmp_path / "stored"
    stored.mkdir()
    monkeypatch.setattr("sys.argv", ["program", "--log", str(log)])
    lines = (
        (lambda: rows.asked_for("What it does.", stored, len), log),
        (lambda: rows.keep(log, {"seed": 1}), log),
        (lambda: rows.tell({"people": 4}, stored), stored),
    )
    for call, path in lines:
        with pytest.raises(SystemExit) as end:
            call()
        assert str(end.value).startswith(f"{path}: can't be written (")
    new = tmp_path / "new" / "log.jsonl"
    monkeypatch.setattr("sys.argv", ["program", "--log", str(new)])
    assert rows.asked_for("What it does.", stored, len).log == new
    assert rows.begun(new) == [] and new.parent.is_dir() and not new.exists()


def test_the_stance_counts_for_as_much_as_was_measured() -> None:
    stored = json.loads(stance.RESULTS.read_text(encoding="utf-8"))
    assert stored["stance_mm"] == pytest.approx(STANCE_MM, abs=0.05)
    twice = [{"annotation": [0.01, 0.01], "stance": [0.02, 0.02]}, {"failed": "no equilibrium"}]
    found = stance.summarised(twice)
    assert (found["subjects"], found["failed"]) == (1, 1)
    assert found["stance_mm"] == pytest.approx(2.0 * stance.ANNOTATION_MM)


def test_a_program_that_measures_at_once_measures_stores_or_prints(tmp_path, monkeypatch, capsys) -> None:
    stored = tmp_path / "found.json"

    def asked(*words):
        monkeypatch.setattr("sys.argv", ["program", *map(str, words)])
        rows.measure_once("What it does.", stored, lambda draws: {"twice": 2 * draws}, draws=4)
        return json.loads(capsys.readouterr().out)

    assert asked("--json") == {}
    found = asked("--draws", 3)
    assert (found["draws"], found["twice"]) == (3, 6) and not stored.exists()
    assert asked("--write")["twice"] == 8 == json.loads(stored.read_text())["twice"]
    assert asked("--json")["date"] == asked("--draws", 1)["date"]


def test_a_program_of_a_place_wants_it(tmp_path, capsys, monkeypatch):
    def asked(*words):
        monkeypatch.setattr("sys.argv", ["program", *map(str, words)])
        rows.measure_once("Doc.", tmp_path / "a.json", lambda at, n: {"at": at.name, "n": n}, place="FOLDER", n=2)
        return capsys.readouterr()

    found = json.loads(asked(tmp_path / "here").out)
    assert (found["at"], found["n"]) == ("here", 2)
    with pytest.raises(SystemExit):
        asked()
    assert "wanted FOLDER or --json" in capsys.readouterr().err
