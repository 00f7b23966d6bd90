"""The paper's Tables 2 to 7 with ours beside them."""

from __future__ import annotations

import pytest

from spinestiff.study.paper import SUBJECTS
from spinestiff.study.seven.tables import paper_tables
from study_outcomes import outcome

FIRST = [outcome(1), None, outcome(3, size=6.0), None, None, None, None]
TABLES = {table.number: table for table in paper_tables(FIRST)}


def line(number, label, whose):
    return next(one for one in TABLES[number].lines if (one.label, one.whose) == (label, whose))


def test_the_six_tables_have_a_column_a_subject():
    assert list(TABLES) == [2, 3, 4, 5, 6, 7]
    for table in TABLES.values():
        assert table.columns == tuple(f"# {i}" for i in range(1, len(SUBJECTS) + 1))
        assert {len(one.cells) for one in table.lines} == {len(SUBJECTS)}
        assert {"paper", "ours"} <= {one.whose for one in table.lines}


@pytest.mark.parametrize(
    ("number", "label", "average"),
    [
        (2, "Age", "12"),
        (2, "Init Cobb (deg)", "12"),
        (2, "Change Cobb (deg)", "22"),
        (2, "Max force (N)", "77"),
        (3, "Axial rotation k_v,β", "91.5"),
        (3, "Lamé parameter λ", "130.3"),
        (4, "Lamé parameter μ", "0.06"),
        (5, "Initial pose", "2.39"),
        (5, "Training poses, default params", "9.94"),
        (5, "Validation pose, optimized params", "3.31"),
        (6, "Diff in validation pose (measured)", "19"),
        (6, "Diff in validation pose (optimized params)", "19"),
        (7, "Lamé parameter μ", "28.6"),
    ],
)
def test_the_papers_lines_have_the_averages_that_it_prints(number, label, average):
    # Two are printed rounded otherwise: 12.4 years and 3.30 mm, whose columns give 3.31.
    whole = {table.number: table for table in paper_tables([outcome(number) for number in range(1, 8)])}
    paper = next(one for one in whole[number].lines if (one.label, one.whose) == (label, "paper"))
    assert paper.average == average


def test_lines_that_have_every_subject_are_averaged_over_those_that_are_there():
    # Subjects 1 and 3.
    assert line(2, "Change Cobb (deg)", "paper").average == "32"
    assert line(5, "Initial pose", "paper").average == "1.82"
    assert line(4, "Intervertebral lateral bending k_v,γ", "truth").average == "0.060"
    assert line(7, "Lamé parameter μ", "paper").average == "19.9"
    assert paper_tables([None] * 7)[0].lines[0].average == "–"


def test_ours_stand_where_there_is_a_subject():
    ours = line(5, "Validation pose, optimized params", "ours")
    assert ours.cells == ("2.00", "–", "1.20", "–", "–", "–", "–")
    assert ours.average == "1.60"
    assert line(2, "Gender", "ours").cells[:2] == ("female", "–")
    assert line(2, "Max force (N)", "ours").cells[0] == "−59"


def test_ratios_stand_beside_the_truth_that_the_papers_mean_here():
    label = "Lamé parameter μ"
    assert line(4, label, "truth").cells[:2] == ("0.014", "0.027")
    assert line(4, label, "ours").cells[0] == "0.022"
    assert line(4, label, "ours, 95 %").cells[0] == "0.016 to 0.030"


def test_the_cobb_change_is_told_in_its_three_forms():
    label = "Diff in validation pose (measured)"
    found = [line(6, label, whose).cells[0] for whose in ("ours", "ours, fixed levels", "ours, tilt")]
    assert found == ["−6.0", "−16.0", "−17.0"]
    assert line(6, label, "ours, fixed levels").average == "16.0"
    assert line(6, "Diff in validation pose (forecast)", "ours, tilt").cells[0] == "−16.5"


def test_baselines_stand_below_table_5():
    assert line(5, "Validation pose, tracking extrapolated by force", "ours").cells[0] == "2.50"
