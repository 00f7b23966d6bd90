"""What ``benchmarks/cohort_of_forty.py`` draws and counts."""

import sqlite3
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from programs import benchmark

forty = benchmark("cohort_of_forty")


def test_people_are_drawn_as_the_figures_say():
    people = [forty.person(seed) for seed in range(1, 401)]
    years = np.array([one.age for one in people]) - forty.MIDDLE_AGE
    assert years.min() >= -3.0 and years.max() <= 3.0
    assert np.mean([one.sex == "female" for one in people]) == pytest.approx(forty.GIRLS, abs=0.06)
    for column, (name, sd) in enumerate(forty.BETWEEN_SD.items()):
        logs = np.log([one.ratios[column] for one in people])
        slope, middle = np.polyfit(years, logs, 1)
        assert np.exp(middle) == pytest.approx(forty.TYPICAL[name], rel=0.1)
        assert np.exp(slope) == pytest.approx(forty.A_YEAR[name], rel=0.05)
        assert np.std(logs - slope * years) == pytest.approx(sd, rel=0.1)


def test_a_seed_is_always_the_same_person():
    assert forty.person(7) == forty.person(7) != forty.person(8)


def test_what_the_cohort_says_is_held_against_the_truth():
    truth = {"sub-01": 0.1, "sub-02": 0.2, "sub-03": 0.1}
    rows = {
        "sub-01": {"stiffness": {"tissue": {"low": 0.05, "high": 0.2}}},
        "sub-02": {"stiffness": {"tissue": {"low": 0.05, "high": 0.19}}},
    }
    found = {
        "people": 2, "left_out": {"sub-03": "failed"}, "mean": 0.12, "mean_low": 0.1, "mean_high": 0.15,
        "between_sd_log": 0.3, "between_low": 0.1, "between_high": 0.5,
        "shrunken": [
            {"participant": "sub-01", "value": 0.1 * np.e, "given_all": 0.1, "low": 0.09, "high": 0.11},
            {"participant": "sub-02", "value": 0.2 * np.e, "given_all": 0.2 * np.e, "low": 0.3, "high": 0.9},
        ],
        "alone": [{"name": "age, a year more", "factor": 1.1, "low": 1.0, "high": 1.3, "p_adjusted": 0.04}],
    }  # fmt: skip
    said = forty.of_stiffness("tissue", truth, found, rows)
    assert said["inside_own_interval"] == [1, 2] and said["inside_given_all"] == [1, 2]
    assert said["rms_log_error"] == pytest.approx({"alone": 1.0, "given_all": np.sqrt(0.5)})
    assert said["mean_log_error"] == pytest.approx(1.0)
    assert said["a_year"] == [1.1, 1.0, 1.3, 0.04] and said["left_out"] == {"failed": 1}


def test_the_last_good_try_of_each_counts(tmp_path):
    with sqlite3.connect(tmp_path / "ledger.sqlite") as book:
        book.execute("CREATE TABLE tries (participant, started, cpu_seconds, peak_mb, seconds, ended)")
        book.executemany(
            "INSERT INTO tries VALUES (?, ?, ?, ?, ?, ?)",
            [
                ("sub-01", "1", 900.0, 9000.0, 900.0, "crashed"),
                ("sub-01", "2", 100.0, 900.0, 110.0, "done"),
                ("sub-02", "3", 300.0, 1100.0, 330.0, "done"),
            ],
        )
    found = forty.costs(tmp_path / "ledger.sqlite")
    assert found["cpu_s"] == {"median": 200.0, "least": 100.0, "most": 300.0}
    assert found["subjects_per_core_hour"] == 18.0 and found["peak_mb"]["most"] == 1100.0


def test_a_body_that_cant_be_made_is_replaced(tmp_path, monkeypatch):
    monkeypatch.setattr(forty, "ProcessPoolExecutor", lambda jobs, mp_context: ThreadPoolExecutor(jobs))
    monkeypatch.setattr(forty, "make", lambda source, seed: "can't be bent" if seed == 2 else None)
    assert forty.make_all(tmp_path / "in", 3, 1) == ([1, 3, 4], {2: "can't be bent"})


def test_those_who_were_made_are_found_again(tmp_path):
    for seed in (1, 3, 12):
        (tmp_path / forty.name_of(seed)).mkdir()
    (tmp_path / ".sub-02.refused").write_text("can't be bent")
    forty.write_table(tmp_path, [1, 3, 12])
    assert forty.made_so_far(tmp_path) == ([1, 3, 12], {2: "can't be bent"})
