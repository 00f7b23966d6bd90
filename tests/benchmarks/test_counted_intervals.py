"""benchmarks/counted_intervals.py: a campaign counted by part; jointly by what was solved at the truth."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from programs import benchmark

counting = benchmark("counted_intervals")
ROOT = Path(__file__).parents[2]
EDGE = float(chi2.ppf(0.95, 2))


def subject(seed, bending=0.1, tissue=0.04, z=(0.5, -0.5), cobb=20.0, solved=1.0, **changed):
    """A row whose intervals are two standard deviations of 0.3 in log either way."""
    truth = {"lateral_bending": bending, "tissue": tissue}
    middle = [value * np.exp(0.3 * one) for value, one in zip(truth.values(), z)]
    return {
        "seed": seed, "ratios": truth, "kind": "", "cobb_deg": cobb, "z": list(z), "joint": 1.0, "joint_solved": solved,
        "low": [value * np.exp(-0.6) for value in middle], "high": [value * np.exp(0.6) for value in middle],
        "open": [False, False], "width_factor": counting.WIDTH_FACTOR, "p_value": 0.5, "tracking_factor": 1.0,
        "rmse_mm": 1.0, "evaluations": 10, "factorisations": 50, "cpu_s": 20.0, "code": "a", "held_out": [], **changed,
    }  # fmt: skip


@pytest.fixture
def rows(tmp_path):
    """As read from a log: nine subjects of which one was not made and one has no estimate."""
    made = [
        subject(1, cobb=-50.0, solved=None),
        subject(2, bending=0.2, solved=EDGE + 1.0, kind="layers"),
        subject(3, bending=0.3, solved=EDGE - 1.0),
        subject(4, bending=0.4, z=(3.0, 0.0), open=[True, False]),
        subject(5, bending=0.5, tissue=0.05, cobb=40.0),
        subject(6, bending=0.6, tissue=0.06, joint=EDGE + 1.0, p_value=1e-4),
        subject(8, bending=0.7, tissue=0.07, kind="stiffening", z=(0.0, 7.0), solved=50.0, code="b"),
    ]
    others = [{"seed": 7, "not made": "why", "code": "a"}, {"seed": 10, "failed": "why", "code": "a"}]
    log = tmp_path / "log.jsonl"
    log.write_text("".join(json.dumps(row) + "\n" for row in [*made, *others]))
    return counting.read_logs([log])


def test_the_joint_region_is_counted_by_what_was_solved_at_the_truth_in_every_part(rows):
    entry = counting.summarised("name", rows, 20)
    # Seed 1 has no equilibrium at the truth, 2 and 8 rise beyond the region; the emulator finds 6 alone outside.
    assert entry["coverage95"]["joint"] == entry["joint"]["all"]["95.0%"][0] == pytest.approx(4 / 7, abs=1e-4)
    assert entry["joint_by_emulator"]["all"]["95.0%"][0] == pytest.approx(6 / 7, abs=1e-4)
    assert entry["outside_999"] == 2
    found = {part: (one["subjects"], one["95.0%"][0]) for part, one in entry["joint"].items()}
    assert found["curve to 40°"] == (5, 0.6) and found["curve 40° to 80°"] == (2, 0.5)
    assert found["layered tissue"] == (1, 0.0) and found["discs with a neutral zone"] == (1, 0.0)
    assert found["body as the model"] == (5, 0.8) and "discs that turn farther behind" not in found
    assert found["open"] == (1, 1.0) and found["closed"] == (6, 0.5)
    assert found["lowest third of lateral_bending"] == (3, pytest.approx(1 / 3, abs=1e-4))
    assert found["highest third of tissue"] == (2, 0.5)


def test_each_ratio_is_counted_by_its_own_interval_and_in_the_same_strata(rows):
    entry = counting.summarised("name", rows)
    bending, tissue = entry["lateral_bending"], entry["tissue"]
    # The truth of seed 4 lies three standard deviations from the middle of an interval of two.
    assert bending["all"]["95.0%"] == [round(6 / 7, 6), round(np.sqrt(6 / 7 * 1 / 7 / 7), 6)]
    assert bending["open"]["95.0%"] == [0.0, 0.0] and bending["closed"]["subjects"] == 6 and "open" not in tissue
    assert bending["curve to 40°"]["95.0%"][0] == 0.8 and bending["curve 40° to 80°"]["95.0%"][0] == 1.0
    # A z of 7 is one of 5 in a mean, and itself in a root of squares.
    assert tissue["discs with a neutral zone"]["bias_sd"] == 5.0 and tissue["discs with a neutral zone"]["rms_z"] == 7.0


def test_misses_are_told_with_their_z_and_with_what_chance_alone_does(rows):
    entry = counting.summarised("name", rows)
    # Six of seven: all but campaigns of seven hits, which chance alone has in 0.95^7 of them. What was solved at the
    # truth of seed 4 bounds its z.
    assert entry["misses"]["lateral_bending"] == {"abs_z": [1.0], "chance": pytest.approx(1 - 0.95**7, abs=1e-3)}
    assert entry["misses"]["tissue"]["abs_z"] == [7.0]
    lines = counting.misses(entry)
    assert lines[0].startswith(
        "- Misses of bending: 1 (absolute z 1.00); exact intervals have so many or more in 30.2 %"
    )
    assert "by z alone: 1: 100.0, 85.7, 57.1 %; 1.05:" in lines[-1]


def test_seeds_states_and_failures_are_told(rows):
    entry = counting.summarised("name", rows, 20)
    assert entry["seeds"] == [[1, 8], [10, 10]] and entry["planned"] == 20
    assert (entry["subjects"], entry["not_made"], entry["without_estimate"], entry["flagged"]) == (7, 1, 1, 1)
    assert entry["code"] == {"a": 8, "b": 1}


def test_another_width_factor_scales_z_and_rises_once(tmp_path):
    log = tmp_path / "log.jsonl"
    log.write_text(json.dumps(subject(1, z=(2.0, 1.0), solved=8.0, width_factor=1.0)) + "\n")
    (row,) = counting.read_logs([log])
    scale = 1.0 / counting.WIDTH_FACTOR
    assert row["z"] == pytest.approx([2.0 * scale, scale])
    assert row["joint_solved"] == pytest.approx(8.0 * scale**2) and row["joint"] == pytest.approx(scale**2)
    # By z, since the interval's ends are those of the other factor.
    assert row["inside"] == [True, True]


def test_the_pages_tables_hold_each_part_with_its_number_and_its_error(monkeypatch, rows):
    entry = counting.summarised("three pushes", rows)
    monkeypatch.setattr(counting, "LEAST_BY_PART", 7)
    lines = counting.markdown([entry]).splitlines()
    assert lines[2].startswith("| three pushes | 7 |") and "57.1 %" in lines[2]
    table = {line.split(" | ")[0].strip("| "): line.split(" | ") for line in lines[6:]}
    assert table["all"][1:4] == ["85.7 ± 13.2 of 7", "85.7 ± 13.2 of 7", "57.1 ± 18.7 of 7"]
    # A third of one ratio has no figure of the other.
    third = table["lowest third of bending"]
    assert third[1].endswith("of 3") and third[2] == "" and third[3] == "33.3 ± 27.2 of 3"
    monkeypatch.setattr(counting, "LEAST_BY_PART", 8)
    assert len(counting.markdown([entry]).splitlines()) == 3


def test_the_first_words_of_the_pages_are_the_stored_campaigns():
    said = counting.headline(json.loads((ROOT / "benchmarks/results/coverage.json").read_text()))
    for page in ("README.md", "docs/index.md", "docs/results.md"):
        assert said in (ROOT / page).read_text(encoding="utf-8"), f"{page} says other than: {said}"


def test_the_page_of_limits_has_the_stored_table():
    lines = counting.short_table(json.loads((ROOT / "benchmarks/results/coverage.json").read_text()))
    told = [line.strip() for line in (ROOT / "docs/limits.md").read_text(encoding="utf-8").splitlines()]
    assert len(lines) == 2 + len(counting.SHORT_NAMES)
    for line in lines[2:]:
        assert line in told, f"docs/limits.md lacks: {line}"


def test_the_pages_tables_are_the_stored_campaigns():
    page = (ROOT / "docs/coverage.md").read_text(encoding="utf-8")
    for block in counting.markdown(json.loads((ROOT / "benchmarks/results/coverage.json").read_text())).split("\n\n"):
        assert block in page, f"docs/coverage.md lacks, of coverage.py --markdown: {block}"


@pytest.mark.parametrize("estimator", ["most_probable_nuisances", "one_kind_at_a_time"])
def test_the_page_of_earlier_estimators_has_each_ones_table(estimator):
    """But none by part."""
    stored = json.loads((ROOT / "benchmarks/results/coverage" / estimator / "coverage.json").read_text())
    table = counting.markdown(stored).split("\n\n")[0]
    assert table in (ROOT / "docs/coverage-earlier.md").read_text(encoding="utf-8"), f"it lacks: {table}"


def test_the_same_people_are_compared_one_by_one():
    def person(seed, z, log):
        estimate = {"lateral_bending": 0.1 * np.exp(log), "tissue": 0.04}
        return subject(seed, z=(z, -0.5), estimate=estimate)

    here = [person(1, 1.0, 0.3), person(2, 2.0, 0.5), person(3, 9.0, 0.0), {"seed": 5, "failed": "why"}]
    there = [person(2, 0.5, 0.1), person(1, 0.0, 0.1), person(4, 0.0, 0.0), person(5, 0.0, 0.0)]
    found = counting.paired(here, there)
    assert found["subjects"] == 2
    assert found["lateral_bending"] == {
        "mean_z": [1.5, 0.25], "difference_z": [1.25, 0.25], "difference_log": [0.3, 0.1]
    }  # fmt: skip
    assert found["tissue"] == {"mean_z": [-0.5, -0.5], "difference_z": [0.0, 0.0], "difference_log": [0.0, 0.0]}
    with pytest.raises(ValueError, match="0 people have an estimate in both"):
        counting.paired(here, [])


def test_people_of_one_stiffness_have_no_thirds(rows):
    same = [{**row, "ratios": {"lateral_bending": 0.07, "tissue": 0.04}} for row in rows]
    entry = counting.summarised("one stiffness", same)
    assert not any("third" in part for name in (*counting.NAMES, "joint") for part in entry[name])
    assert any("third" in part for part in counting.summarised("three pushes", rows)["joint"])


def test_a_campaign_is_repeated_with_the_seeds_and_settings_of_its_rows(monkeypatch, tmp_path):
    """Settings were looked at on bodies of two sizes of mesh, with seeds that are in no scenario's range."""
    script = ROOT / "benchmarks" / "coverage.py"
    monkeypatch.setattr(sys, "argv", [str(script), "--json"])
    monkeypatch.setitem(sys.modules, "coverage", None)
    monkeypatch.syspath_prepend(str(script.parent))
    program = runpy.run_path(str(script), run_name="__main__")
    monkeypatch.setitem(program["kept"].__globals__, "LOGS", tmp_path)
    log, again = program["log_of"]("settings, the paper's acquisition"), tmp_path / "again"
    made = {20230: 2300, 801: 3000}
    rows = [{**subject(seed), "acquisition": "paper", "nodes": nodes, "mesh": "coarse", "first": 500, "count": 230}
            for seed, nodes in made.items()]  # fmt: skip
    log.write_text("".join(json.dumps(row) + "\n" for row in rows))
    asked = [(seed, scenario.nodes, scenario.acquisition, path) for seed, scenario, path in program["kept"](again)]
    assert asked == [(seed, nodes, "paper", again / log.name) for seed, nodes in made.items()]
