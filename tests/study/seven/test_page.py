"""The study's page."""

from __future__ import annotations

from dataclasses import replace

from spinestiff.study.seven.page import Picture, Pictures, page_text
from study_outcomes import frame, outcome

PICTURES = Pictures((Picture("2", "images/study-figure-2.png", "Tracked corners"),))


def page(first, further=(), pictures=PICTURES, lacking=None):
    return page_text(first, further, pictures, "2026-01-02", "9.9+0123", "fine", lacking or {})


def section(text, title):
    """Of a page, from its heading to the next one."""
    return text.partition(f"## {title}\n")[2].partition("\n## ")[0]


def test_a_whole_study_has_everything_in_order():
    text = page([outcome(number) for number in range(1, 8)], [outcome(1, name="other-01")])
    headings = [line for line in text.splitlines() if line.startswith("#")]
    assert headings == [
        "# The study: the paper's seven",
        "## Goals",
        "## The paper's tables",
        "### Table 2: Main characteristics of the subjects",
        "### Table 3: Gradient of the objective in six parameters, at the default (ours on the coarse mesh)",
        "### Table 4: Parameter ratios",
        "### Table 5: RMSE (mm) between measured and simulated features",
        "### Table 6: Cobb angle (deg)",
        "### Table 7: Change of the ratios, %, for 10 % of force (ours on the coarse mesh)",
        "## Figures",
        "## Held-out frames: the seven",
        "## Held-out frames: the others",
        "## The others, one by one",
        "## Intervals",
        "## Intervals: the others",
        "## The paper's discussion (6.1), point by point",
        "## The paper's conclusions (6.2), point by point",
        "## Forward test",
        "## Time",
    ]
    assert "Written on 2026-01-02 from the outcomes of `spinestiff study seven DIR --mesh fine`" in text
    assert "Estimates are on the fine mesh, Tables 3 and 7 on the coarse one." in text
    assert "**7 of the 7 subjects** and **1 of the 30 others**" in text
    assert "not finished" not in text
    assert "![Tracked corners](images/study-figure-2.png)" in text
    assert "| other-01: thoracic, +11°, −59 N | 0.1: 0.11 |" in text
    # Drawn with 60.1 N, pushed with 59.
    assert "more than 45° against each other (other-01)." in text
    as_drawn = page([outcome(1)], [outcome(1, name="other-01", force_n=60.1)])
    assert "from 45 to 114 N; a push ends where it would turn two vertebrae by more than 45°" in as_drawn
    assert "against each other (none of these)." in as_drawn


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
    by_chance = "(fewer than promised: by chance so few in 5.0 % of studies)"
    assert f"- Tissue: the truth lies in 0 of 1 95 % intervals {by_chance}; the estimate is off by a factor of" in text
    assert "- Bending: the truth lies in 1 of 1" in text


def test_a_subject_without_an_interval_is_no_interval_that_holds_the_truth():
    without = outcome(2)
    ratio = without.ratios["tissue"].model_copy(update={"low": None, "high": None})
    without = without.model_copy(update={"ratios": {**without.ratios, "tissue": ratio}})
    text = section(page([outcome(1), without, *[None] * 5]), "Intervals")
    assert "- Tissue: the truth lies in 1 of 1 95 % intervals, 1 more have none; the estimate is off by" in text
    assert "- Bending: the truth lies in 2 of 2 95 % intervals; the estimate" in text


def test_the_forward_test_is_that_of_the_papers_changes():
    text = page([outcome(1, change_deg=-20.0), outcome(2, change_deg=-7.0), *[None] * 5])
    # The paper's: -19 and +13 degrees.
    assert (
        "off by 14.2° (root mean square over 2; no change at all would be by 16.3°), with the paper's sign in 1."
        in text
    )


def test_the_time_of_each_subject_and_of_all_stands_against_the_aim():
    # 50 s to make and 90 s to estimate.
    text = section(page([outcome(number) for number in range(1, 8)]), "Time")
    assert "| subject-7 | – | 50 | – | – | 90 | – | – | 140 |" in text
    assert "| sum |  | 350 | – | – | 630 | – | – | 980 |" in text
    assert "The aim is 20 minutes for the seven on 2 cores. These 7 subjects take 980 CPU s in sum" in text
    # Four one after the other.
    assert "that is 9 min. The aim is met." in text
    slow = section(
        page([outcome(number, cpu_seconds={"make": 200.0, "assess": 200.0}) for number in range(1, 8)]), "Time"
    )
    assert "2,800 CPU s in sum" in slow and "that is 27 min. **The aim is not met**." in slow


def test_the_time_of_some_of_the_seven_does_not_meet_their_aim_yet():
    text = section(page([outcome(1), *[None] * 6]), "Time")
    assert "that is 2 min. Whether the aim is met is not known." in text
    slow = outcome(1, cpu_seconds={"make": 1500.0})
    assert "that is 25 min. **The aim is not met**." in section(page([slow, *[None] * 6]), "Time")


def test_where_the_time_of_making_is_not_known_the_sum_is_told_as_a_least_one():
    quick = outcome(2, cpu_seconds={"estimate": 70.0})
    text = section(page([outcome(1), quick, *[None] * 5]), "Time")
    assert "| subject-2 | – | – | – | – | 70 | – | – | 70 |" in text
    assert "that is at least 2 min. Whether the aim is met is not known. Radiographs of subject-2 were made by" in text
    assert "were made by" not in section(page([outcome(1), *[None] * 6]), "Time")


def test_the_others_have_a_table_of_their_own_and_no_aim():
    text = page([outcome(1), *[None] * 6], [outcome(2, name="other-01")])
    assert "| other-01 | – | 50 |" in section(text, "Time")
    row = next(line for line in text.splitlines() if line.startswith("| time of the seven"))
    assert row.endswith("| ≤ 20 min: 2 min, met so far | no aim |")


def test_programs_and_days_that_found_the_outcomes_are_named():
    first = [outcome(number, program="9.9+0123", date="2026-01-01") for number in range(1, 8)]
    assert "The numbers were found by program `9.9+0123` (7 subjects; 2026-01-01).\n" in page(first)
    old = page([outcome(number, program="9.8+4567") for number in range(1, 8)])
    assert "`9.8+4567` (7 subjects; day not noted). The page was written by program `9.9+0123`, which may find" in old
    assert "differing" not in old
    mixed = page([outcome(1, program="9.8+4567", date="2025-12-31"), *first[1:]])
    assert "The subjects were found by differing programs, which may estimate differently. " in mixed
    assert "`9.8+4567` (subject-1; 2025-12-31) and `9.9+0123` (subject-2, subject-3," in mixed
    assert "| subject-1 | 2025-12-31 | 50 |" in mixed


def test_subjects_that_are_in_no_picture_and_pictures_of_an_earlier_page_are_named():
    first = [outcome(1), outcome(2), *[None] * 5]
    text = section(page(first, pictures=replace(PICTURES, undrawn=("subject-1",))), "Figures")
    assert text.lstrip().startswith("1 subject could not be drawn (subject-1): ")
    assert "earlier page" not in text and "![Tracked corners](images/study-figure-2.png)" in text
    kept = section(page(first, pictures=replace(PICTURES, undrawn=("subject-1", "subject-2"), kept=("2",))), "Figures")
    assert "Fig. 2: of an earlier page, whose numbers may differ" in kept
    assert "could not be drawn" not in page(first)


def test_goals_of_the_cobb_angle_are_judged_in_the_papers_form_too():
    """One in which the estimate's largest angle passes to another curve, so that it is off by far more."""
    main = frame("main")
    jumped = main.cobb_deg["fit"].model_copy(update={"signed": main.cobb_deg["measured"].signed + 20.0})
    main = main.model_copy(update={"cobb_deg": {**main.cobb_deg, "fit": jumped}})
    text = page([outcome(number, frames=(main,)) for number in range(1, 8)])
    goals = section(text, "Goals")
    assert "| error of the Cobb angle's change between fixed levels, estimate, mean | ≤ 2.9°: 1.0°, met |" in goals
    for which, limit in (("mean", "2.9"), ("worst", "5")):
        name = "error of the Cobb angle's change as signed largest angle (the paper's form, its Table 6)"
        assert f"| {name}, estimate, {which} | ≤ {limit}°: 20.0°, **not met** |" in goals
        assert f"| {name}, forecast, {which} | ≤ {limit}°: 0.5°, met |" in goals
    assert "**The same in the paper's form**, the signed largest angle: 0.8 times, 16.0° and 20.0° in the mean." in text


def test_intervals_that_hold_too_few_truths_are_told_as_such():
    first = [outcome(number, inside=number > 3) for number in range(1, 7)] + [outcome(7, inside=None)]
    text = section(page(first), "Intervals")
    # Binomial: P(at most 3 of 6) at 0.95 is 0.22 %.
    assert "- Both together: the truth lies in 3 of 6 joint 95 % regions, of 1 more it is not known (fewer" in text
    assert "by chance so few in 0.2 % of studies)." in text
    assert "Bending: the truth lies in 7 of 7 95 % intervals; the estimate" in text


def test_who_has_no_outcome_is_named_with_the_reason():
    lacking = {"subject-3": "no equilibrium", "other-06": "MemoryError: no room"}
    lacking |= dict.fromkeys(["other-07", "other-08", "other-28", "other-29", "other-30"])
    text = page([outcome(1), *[None] * 6], [outcome(2, name="other-01")], lacking=lacking)
    told = (
        "The last run failed for subject-3 (no equilibrium); other-06 (MemoryError: no room); what is told of them is"
    )
    waiting = "No outcome, and no reason noted, of other-07, other-08 and other-28 to other-30."
    assert f"\n\n{told} of an earlier one. {waiting}\n\n" in text
    assert "The last run failed" not in page([outcome(1)]) and "No outcome" not in page([outcome(1)])


def test_the_seven_and_the_others_are_no_row_of_names():
    lacking = dict.fromkeys(["subject-6", "subject-7", "other-08", "other-09"])
    text = page([outcome(1)], lacking=lacking)
    assert "no reason noted, of subject-6, subject-7, other-08 and other-09.\n" in text


def test_the_others_have_their_intervals_failed_checks_and_what_could_not_be_found():
    doubtful = outcome(1, name="other-01", failed=("fit of one vertebra",), missing=("Table 7: no refit",))
    text = page([outcome(number) for number in range(1, 8)], [doubtful])
    assert "other-01 (fit of one vertebra)" in section(text, "Intervals: the others")
    assert "the truth lies in 1 of 1 95 % intervals" in section(text, "Intervals: the others")
    assert "### What could not be found\n\n- other-01: Table 7: no refit.\n" in text


def test_the_estimates_own_places_are_judged_against_tracking_too():
    goals = section(page([outcome(number) for number in range(1, 8)]), "Goals")
    for where in ("another rib", "the other side"):
        assert f"| median RMSE at {where}, estimate against tracking extrapolated by force | below " in goals
