"""Results of two runs, held against each other: a changed byte is seen, a time is not."""

from __future__ import annotations

import json

import pytest

from programs import benchmark

interrupted_runs = benchmark("interrupted_runs")
same_results = benchmark("same_results")
RATIO = {"value": 0.1, "low": 0.05, "high": 0.2}


@pytest.fixture
def folders(tmp_path):
    for name in ("one", "other"):
        written = tmp_path / name / "results"
        (written / "logs").mkdir(parents=True)
        (written / "estimate.json").write_text(json.dumps({"ratios": {"tissue": RATIO}, "cost": {"seconds": 1.0}}))
        (written / "report.html").write_bytes(b"<p>0.1</p>")
        (written / "logs" / "run.jsonl").write_text("")
    return tmp_path / "one", tmp_path / "other"


def test_times_and_logs_are_no_difference(folders):
    one, other = folders
    (other / "results" / "logs" / "run.jsonl").write_text("another day")
    (other / "results" / "run.json").write_text("{}")
    (other / "results" / "estimate.json").write_text(
        json.dumps({"ratios": {"tissue": RATIO}, "cost": {"seconds": 2.0}})
    )
    assert interrupted_runs.unlike(one, other) == []


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("report.html", b"<p>0.2</p>"),
        ("estimate.json", json.dumps({"ratios": {"tissue": RATIO}, "more": 0}).encode()),
        ("figures.png", b"new"),
    ],
)
def test_a_byte_or_a_file_more_is_one(folders, name, content):
    one, other = folders
    (other / "results" / name).write_bytes(content)
    assert interrupted_runs.unlike(one, other) == [f"results/{name}"]


def test_ratios_and_the_ends_of_their_intervals_are_compared(folders):
    assert same_results.numbers(folders[0]).tolist() == [0.1, 0.05, 0.2]
