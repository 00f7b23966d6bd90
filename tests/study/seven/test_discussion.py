"""The study in words."""

from __future__ import annotations

import pytest

from spinestiff.study.paper import TABLE_5
from spinestiff.study.seven.discussion import (
    REASONS,
    correlation,
    differing,
    points_of_conclusions,
    points_of_results,
)
from spinestiff.study.seven.tables import OURS, PAPER, paper_tables
from study_outcomes import frame, outcome

SEVEN = [outcome(number, size=20.0 - 2 * number) for number in range(1, 8)]


def rows(first):
    """Of all tables, by label."""
    found = [line for table in paper_tables(first) for line in differing(table)]
    return {line[2:].partition("**")[0]: line.partition(": ")[2] for line in found}


def test_a_row_is_discussed_where_it_differs_by_a_tenth():
    paper = TABLE_5["Initial pose"]
    near = [outcome(number, initial_mm=value * 1.09) for number, value in enumerate(paper, 1)]
    assert not any("Initial pose" in line for line in differing(paper_tables(near)[3]))
    far = [outcome(number, initial_mm=2.39 * 1.12) for number in range(1, 8)]
    (line,) = [line for line in differing(paper_tables(far)[3]) if "Initial pose" in line]
    assert "2.68 against the paper's 2.39, 0.71 apart in the mean over subjects. " in line


def test_the_average_discussed_is_that_of_the_table_above_it():
    # The paper's Cobb changes of these two are -46 and -20 degrees; cells are rounded to whole degrees.
    first = [None, None, outcome(3, change_deg=-20.49), None, None, None, outcome(7, change_deg=-12.49)]
    assert rows(first)["Change Cobb (deg)"].startswith("16 against the paper's 33, ")
    (ours,) = [line for line in paper_tables(first)[0].lines if (line.label, line.whose) == ("Change Cobb (deg)", OURS)]
    assert ours.average == "16"


def test_a_row_is_compared_over_the_subjects_that_it_has_and_says_how_many():
    first = [outcome(1, initial_mm=1.6), *[None] * 6]
    assert not any("Initial pose" in line for line in differing(paper_tables(first)[3]))
    label = "Validation pose, optimized params"
    # The paper's of subject 1 is 3.29 mm, whoever else is there without a validation frame.
    for others in ([None] * 6, [outcome(2, frames=()), *[None] * 5]):
        assert rows([first[0], *others])[label].startswith("2.00 against the paper's 3.29, 1.29 apart ")


def test_rows_that_lack_a_subject_are_discussed_over_the_others():
    first = [outcome(1, force_percent={}), *(outcome(number) for number in range(2, 8))]
    table = paper_tables(first)[-1]
    lines = differing(table)
    # The paper's of subjects 2 to 7 are 44.4, 14.7, 27.8, 18.2, 40 and 30 %.
    assert lines[1].startswith("**Lamé parameter μ** (6 of 7 subjects): 11.0 against the paper's 29.2, 18.2 apart ")
    assert len(lines) == 2 and "Where a body is linear" in lines[0]
    whole = [line for line in differing(paper_tables(SEVEN)[-1]) if "Lamé" in line]
    assert whole[0].startswith("**Lamé parameter μ**: 11.0 against the paper's 28.6, 17.6 apart ")


def test_a_row_is_discussed_where_subjects_differ_though_their_average_does_not():
    paper = [-19.0, 13.0, -46.0, 25.0, 8.0, -26.0, -20.0]
    alike = [outcome(number, change_deg=value) for number, value in enumerate(paper, 1)]
    assert "Change Cobb (deg)" not in rows(alike)
    turned = [outcome(number, change_deg=-value) for number, value in enumerate(paper, 1)]
    assert rows(turned)["Change Cobb (deg)"].startswith(
        "22 against the paper's 22, 45 apart in the mean over subjects. "
    )


def test_gradients_are_compared_by_their_order():
    theirs = "in the paper Lamé parameter μ, Lateral bending k_v,γ, Lamé parameter λ, Axial rotation k_v,β, "
    (point,) = [one for one in points_of_conclusions(SEVEN) if "shear modulus explain most" in one]
    assert f"{theirs}Lateral translation k_v,x, Flexion/extension k_v,α. " in point


def test_every_row_that_can_differ_has_a_reason():
    for found in paper_tables(SEVEN):
        for label in dict.fromkeys(one.label for one in found.lines if one.whose == PAPER):
            words = label in ("Gender", "Scoliosis Curve")
            assert words or (found.number, label) in REASONS, label


def test_points_are_judged_by_what_was_found():
    good = points_of_results(SEVEN)
    assert len(good) == 10
    assert "Holds." in good[1] and "From 12.0 to 2.40 mm, 0.20 of it." in good[1]
    assert (
        "Rank correlation of the default's RMSE with the estimated tissue ratio: −1.00. Criterion: below 0. Holds."
        in good[4]
    )
    bad = points_of_results([one.model_copy(update={"training_mm": {"default": 3.0, "fit": 2.0}}) for one in SEVEN])
    assert bad[1].endswith("**Does not hold here.**")


def test_what_is_said_of_every_subject_needs_a_frame_of_every_subject():
    assert points_of_results(SEVEN)[5].endswith("less than the default in every subject. Holds.")
    lacking = [*SEVEN[:6], outcome(7, frames=())]
    assert points_of_results(lacking)[5].endswith("Not to be judged yet.")
    worse = frame("main").model_copy(update={"rmse_mm": {"default": 1.0, "fit": 2.0}})
    found = points_of_results([outcome(1, frames=(worse,)), *lacking[1:]])
    assert found[5].endswith("**Does not hold here.**")


def test_an_estimate_may_lie_below_the_true_ratios_error():
    """It is fitted, and they are not: what is said of the row has to bear both."""
    better = [
        one.model_copy(update={"frames": (frame("main").model_copy(update={"rmse_mm": {"fit": 0.1, "truth": 3.0}}),)})
        for one in SEVEN
    ]
    assert rows(better)["Validation pose, optimized params"].endswith("For the same reason.")
    assert "may lie below that line" in rows(better)["Training poses, optimized params"]
    assert not any("gets below" in reason for reason in REASONS.values())


def test_conclusions_are_judged_by_what_was_found():
    good = points_of_conclusions(SEVEN)
    assert len(good) == 8
    assert good[-1].endswith("Holds.") and "7 of 7 truths lie in the joint 95 % region" in good[-1]
    worse = frame("main", size=30.0)
    bad = points_of_conclusions([outcome(number, frames=(worse,)) for number in range(1, 8)])
    assert "6.00 mm. Criterion: at most 3.3 mm in the mean. **Does not hold here.**" in bad[4]
    assert "7 of 21 held-out frames could be used" in bad[6]
    assert "Not to be judged yet." in bad[5]


def test_nothing_is_said_of_nobody():
    for points in (points_of_results([]), points_of_conclusions([])):
        assert not any("Holds." in one or "hold here" in one for one in points)


def test_correlation_is_of_ranks():
    assert correlation([1.0, 2.0, 30.0], [1.0, 4.0, 5.0]) == pytest.approx(1.0)
    assert correlation([1.0, 2.0], [1.0, 2.0]) is None
    assert correlation([1.0, 1.0, 1.0], [1.0, 2.0, 3.0]) is None


def test_every_verdict_has_its_criterion_and_waits_for_all_seven():
    points = [*points_of_results(SEVEN), *points_of_conclusions(SEVEN)]
    judged = [one for one in points if one.endswith(("Holds.", "hold here.**"))]
    assert sum("Criterion: " in one for one in points) == len(points) - 2
    # The default's errors of the Cobb angle are all the same here, so that they have no ranks.
    assert len(judged) == len(points) - 3 and all("Criterion: " in one for one in judged)
    for one in (*points_of_results(SEVEN[:6]), *points_of_conclusions(SEVEN[:6])):
        assert not one.endswith(("Holds.", "hold here.**"))
        assert one.endswith("Not to be judged yet.") == ("Criterion: " in one)


def test_tissue_is_judged_by_the_motions_that_a_single_ratio_misses():
    assert points_of_conclusions(SEVEN)[3].endswith("less than one (medians). Holds.")
    other = frame("other-side")
    other = other.model_copy(update={"motion_mm": {**other.motion_mm, "single_ratio": 0.5}})
    frames = (frame("main"), frame("other-rib"), other)
    worse = points_of_conclusions([outcome(number, frames=frames) for number in range(1, 8)])
    assert worse[3].endswith("less than one (medians). **Does not hold here.**")
