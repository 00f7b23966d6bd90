"""The study in words."""

from __future__ import annotations

import pytest

from spinestiff.study.seven.discussion import (
    REASONS,
    correlation,
    differing,
    points_of_conclusions,
    points_of_results,
)
from spinestiff.study.seven.tables import OURS, PAPER, Line, PaperTable, paper_tables
from study_outcomes import frame, outcome

SEVEN = [outcome(number, size=20.0 - 2 * number) for number in range(1, 8)]


def table(paper, ours, label="Initial pose", number=5):
    columns = tuple(f"# {i}" for i in range(len(paper)))
    lines = (Line(label, PAPER, tuple(paper), ""), Line(label, OURS, tuple(ours), ""))
    return PaperTable(number, "", columns, lines)


def test_a_row_is_discussed_where_it_differs_by_a_tenth():
    assert differing(table(("2.0", "2.0"), ("2.1", "2.2")), (True, True)) == []
    (found,) = differing(table(("2.0", "2.0"), ("2.4", "2.2")), (True, True))
    assert found.startswith("**Initial pose**: 2.30 against the paper's 2.00. ")


def test_only_subjects_that_are_there_count():
    both = table(("2.0", "9.0"), ("2.0", "2.0"))
    assert differing(both, (True, False)) == []
    assert len(differing(both, (True, True))) == 1
    assert differing(table(("2.0", "9.0"), ("2.0", "–")), (True, False)) == []


def test_signed_rows_are_compared_by_size():
    label = "Diff in validation pose (measured)"
    assert differing(table(("−16", "−16"), ("+16", "−16"), label, 6), (True, True)) == []


def test_every_row_that_can_differ_has_a_reason():
    for found in paper_tables(SEVEN):
        for label in dict.fromkeys(one.label for one in found.lines if one.whose == PAPER):
            words = label in ("Gender", "Scoliosis Curve")
            assert words or (found.number, label) in REASONS, label


def test_points_are_judged_by_what_was_found():
    good = points_of_results(SEVEN)
    assert len(good) == 9
    assert "Holds." in good[1] and "From 12.0 to 2.40 mm, 0.20 of it." in good[1]
    assert "Rank correlation of the default's RMSE with the estimated tissue ratio: −1.00. Holds." in good[4]
    bad = points_of_results([one.model_copy(update={"training_mm": {"default": 3.0, "fit": 2.0}}) for one in SEVEN])
    assert bad[1].endswith("**Does not hold here.**")


def test_conclusions_are_judged_by_what_was_found():
    good = points_of_conclusions(SEVEN)
    assert len(good) == 8
    assert good[-1].endswith("Holds.") and "7 of 7 truths lie in the joint 95 % region" in good[-1]
    worse = frame("main", size=30.0)
    bad = points_of_conclusions([outcome(1, frames=(worse,))])
    assert "6.00 mm. **Does not hold here.**" in bad[4]
    assert "Not to be judged yet." in bad[5]


def test_nothing_is_said_of_nobody():
    for points in (points_of_results([]), points_of_conclusions([])):
        assert not any("Holds." in one or "hold here" in one for one in points)


def test_correlation_is_of_ranks():
    assert correlation([1.0, 2.0, 30.0], [1.0, 4.0, 5.0]) == pytest.approx(1.0)
    assert correlation([1.0, 2.0], [1.0, 2.0]) is None
    assert correlation([1.0, 1.0, 1.0], [1.0, 2.0, 3.0]) is None
