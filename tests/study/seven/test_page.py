"""The study's page."""

from __future__ import annotations

from spinestiff.study.seven.page import Picture, page_text
from study_outcomes import outcome

PICTURES = [Picture("2", "images/study-figure-2.png", "Tracked corners")]


def page(first, further=()):
    return page_text(first, further, PICTURES, "2026-01-02", "9.9", "fine")


def test_a_whole_study_has_everything_in_order():
    text = page([outcome(number) for number in range(1, 8)], [outcome(1, name="other-01")])
    headings = [line for line in text.splitlines() if line.startswith("#")]
    assert headings == [
        "# The study: the paper's seven",
        "## Goals",
        "## The paper's tables",
        "### Table 2: Main characteristics of the subjects",
        "### Table 3: Gradient of the objective in six parameters, at the default",
        "### Table 4: Parameter ratios",
        "### Table 5: RMSE (mm) between measured and simulated features",
        "### Table 6: Cobb angle (deg)",
        "### Table 7: Change of the ratios, %, for 10 % of force",
        "## Figures",
        "## Held-out frames: the seven",
        "## Held-out frames: the others",
        "## The others, one by one",
        "## Intervals",
        "## The paper's discussion (6.1), point by point",
        "## The paper's conclusions (6.2), point by point",
        "## Forward test",
        "## Cost",
    ]
    assert "2026-01-02, version 9.9, estimates on the fine mesh" in text
    assert "**7 of the 7 subjects** and **1 of the 30 others**" in text
    assert "not finished" not in text and "`spinestiff study seven DIR --mesh fine`" in text
    assert "![Tracked corners](images/study-figure-2.png)" in text
    assert "| other-01: thoracic, +11°, −59 N | 0.1: 0.11 |" in text


def test_an_unfinished_study_says_so_and_holds_what_is_there():
    text = page([None, outcome(2), *[None] * 5])
    assert "**1 of the 7 subjects** and **0 of the 30 others**" in text
    assert "The study is not finished" in text
    assert "The others, one by one" not in text
    assert page([None] * 7).count("## ") == 1


def test_what_could_not_be_found_stands_below_the_tables():
    text = page([outcome(1, force_percent={}, missing=("Table 7: no refit with +10 % of force (stalled)",))])
    assert "### What could not be found\n\n- subject-1: Table 7: no refit with +10 % of force (stalled).\n" in text
    assert "What could not be found" not in page([outcome(1)])


def test_predictors_without_a_prediction_are_named():
    one = outcome(1)
    side = one.frames[-1].model_copy(update={"rmse_mm": {**one.frames[-1].rmse_mm, "single_ratio": None}})
    text = page([one.model_copy(update={"frames": (*one.frames[:-1], side)})])
    assert "- subject-1: Held-out frames: a single ratio predicts nothing for the other side.\n" in text


def test_goals_stand_beside_each_other_with_their_verdicts():
    text = page([outcome(1, initial_mm=3.0)], [outcome(2)])
    row = next(line for line in text.splitlines() if line.startswith("| geometry's RMSE"))
    assert "3.00 mm, **not met** so far |" in row and "2.30 mm, met so far |" in row
    whole = page([outcome(number) for number in range(1, 8)])
    assert "2.30 mm, met |" in whole and "so far" not in whole


def test_tables_are_rectangular():
    text = page([outcome(number) for number in range(1, 8)], [outcome(1)])
    widths, inside = [], False
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            widths.append(line.count("|"))
            inside = True
        elif inside:
            assert len(set(widths)) == 1, line
            widths, inside = [], False


def test_intervals_count_the_truths_that_they_hold():
    off = outcome(1)
    ratio = off.ratios["tissue"].model_copy(update={"high": 0.019, "value": 0.018})
    text = page([off.model_copy(update={"ratios": {**off.ratios, "tissue": ratio}}), *[None] * 6])
    assert "- Tissue: the truth lies in 0 of 1 95 % intervals; the estimate is off by a factor of 1.11" in text
    assert "- Bending: the truth lies in 1 of 1" in text


def test_the_forward_test_is_that_of_the_papers_changes():
    text = page([outcome(1, change_deg=-20.0), outcome(2, change_deg=-7.0), *[None] * 5])
    # The paper's: -19 and +13 degrees.
    assert (
        "off by 14.2° (root mean square over 2; no change at all would be by 16.3°), with the paper's sign in 1."
        in text
    )


def test_a_subject_that_an_earlier_run_made_does_not_count_in_the_cost_of_making():
    quick = outcome(2, seconds={"estimate": 70.0})
    text = page([outcome(1), quick, *[None] * 5])
    assert "median: make 50, estimate 80; together 140 (largest 140)." in text
    assert "1 of 2 were made by an earlier run" in text
    assert "earlier run" not in page([outcome(1), *[None] * 6])
    assert "median: estimate 70; together – (largest –)." in page([None, quick, *[None] * 5])
