"""Figures in a page: every colour has one for the dark, a figure refers to itself alone, labels stand apart."""

from __future__ import annotations

import re

import numpy as np
import pytest
from matplotlib.figure import Figure

from spinestiff.study.report import figures
from spinestiff.study.report.certainty_pictures import (
    BudgetBars,
    ProfileCurve,
    RatioMap,
    SupportPlace,
    draw_budget,
    draw_profiles,
    draw_ratio_map,
    draw_support_places,
)
from spinestiff.study.report.curve_pictures import CurveChange, TiltChange, draw_curve_changes, draw_tilt_changes
from spinestiff.study.report.figures import as_svg, part_tick_labels, plain_ticks
from spinestiff.study.report.theme import DARK, dark_style, for_page

LINE = np.array([[0.0, 0.0], [60.0, -12.0]])
SEEN = np.column_stack([LINE, [0.0, 1.0]])


def drawn() -> dict[str, Figure]:
    region = np.exp(np.random.default_rng(1).normal(-2.0, 0.3, (20, 2)))
    ends = ((0.1, 0.2), (0.1, 0.2))
    place = SupportPlace(1.0, 2.0, (0.5, 0.3), True)
    rows = np.array([[0.1, 0.4]])
    measured = dict.fromkeys(("training", "validation", "unused"), SEEN)
    return {
        "curves": draw_curve_changes([CurveChange("main", measured, {"fit": LINE, "default": LINE})]),
        "tilts": draw_tilt_changes([TiltChange("main", ("T5", "T6"), np.ones(2), {"fit": np.ones(2)}, 0.5)]),
        "ratios": draw_ratio_map(
            RatioMap(("a", "b"), region.mean(0), region, np.ones((2, 2)), (0.0025, 5.0), ends, region[0])
        ),
        "profiles": draw_profiles(
            [ProfileCurve("a", np.array([[0.1, 3.0], [0.15, 0.0], [0.2, 3.0]]), 1.9, (0.11, 0.19), 0.15, 0.16)]
        ),
        "supports": draw_support_places(["frame 1"], {"pelvis": [place]}),
        "budget": draw_budget(BudgetBars(("gauge",), {"a": rows})),
    }  # fmt: skip


@pytest.mark.parametrize("name", list(drawn()))
def test_every_colour_of_a_figure_has_one_for_the_dark(name: str) -> None:
    svg = as_svg(drawn()[name]).decode()
    colours = set(re.findall(r"(?:fill|stroke): (#[0-9a-f]{6})", svg))
    assert len(colours) > 3
    assert colours <= set(DARK)
    # What has no colour is black by SVG's rules, which the dark theme could not change.
    shown = re.findall(r'<(?:path|use)[^>]*style="([^"]*)"', for_page(svg.encode(), "one"))
    assert shown and all("var(--f-" in style or "fill: none" in style for style in shown)


def test_colours_become_variables_that_fall_back_to_themselves() -> None:
    page = for_page(b'<svg xmlns="http://www.w3.org/2000/svg"><path style="fill: #0072b2; stroke: none"/></svg>', "one")
    assert page == (
        '<svg class="drawing" aria-hidden="true" focusable="false">'
        '<path style="fill: var(--f-0072b2, #0072b2); stroke: none"/></svg>'
    )
    assert "--f-0072b2: #6cb8f0;" in dark_style() and dark_style().count("--f-") == len(DARK)


def test_two_figures_in_a_page_share_no_name() -> None:
    svg = as_svg(drawn()["curves"])
    one, other = for_page(svg, "one"), for_page(svg, "other")
    names = [set(re.findall(r' id="([^"]*)"', page)) for page in (one, other)]
    assert names[0] and not names[0] & names[1]
    used = set(re.findall(r'(?:href="#|url\(#)([^")]*)', one))
    assert used and used <= names[0]
    assert "xmlns" not in one and "<!--" not in one and "http" not in one


def test_titles_from_files_are_in_no_figure() -> None:
    """Letters are drawn as outlines; the comments that name them are dropped."""
    change = CurveChange("--><script>x</script>", {"training": SEEN}, {"fit": LINE})
    assert "script" not in for_page(as_svg(draw_curve_changes([change])), "one")


def overlaps(figure: Figure) -> int:
    figure.draw_without_rendering()
    count = 0
    for axes in figure.axes:
        for side, along in ((axes.xaxis, 0), (axes.yaxis, 1)):
            labels = [tick.label1 for tick in side.get_major_ticks()]
            boxes = [label.get_window_extent() for label in labels if label.get_visible() and label.get_text()]
            boxes.sort(key=lambda box: box.min[along])
            count += sum(b.min[along] < a.max[along] + 1.0 for a, b in zip(boxes, boxes[1:]))
    return count


def test_names_stay_where_numbers_would_go() -> None:
    figure = Figure(figsize=(2.0, 2.0), layout="constrained")
    axis = figure.subplots()
    axis.set_xticks(range(9), [f"visit of {number}" for number in range(9)], fontsize=9)
    assert overlaps(figure) > 0
    part_tick_labels(figure)
    assert all(tick.label1.get_visible() for tick in axis.xaxis.get_major_ticks())


def test_every_panel_that_has_none_below_it_shows_its_degrees() -> None:
    one = TiltChange("main", ("T5", "T6"), np.array([-3.0, 4.0]), {"fit": np.ones(2)}, 0.5)
    figure = draw_tilt_changes([one] * 5)
    figure.draw_without_rendering()
    shown = [axis for axis in figure.axes if axis.get_visible()]
    assert len(shown) == 5
    for axis in shown:
        assert any(label.get_visible() and label.get_text() for label in axis.get_xticklabels())


def test_tick_labels_never_touch() -> None:
    random = np.random.default_rng(2)
    touched = 0
    with figures.rc_context(figures.STYLE):
        for _ in range(30):
            figure = Figure(figsize=(random.uniform(1.2, 4.0), random.uniform(1.0, 3.0)), layout="constrained")
            axis = figure.subplots()
            low = 10.0 ** random.uniform(-4.0, 1.0)
            axis.plot([low, low * 10.0 ** random.uniform(0.05, 3.5)], [-1000.0, 12345.6])
            axis.set_xscale("log")
            plain_ticks(axis, "x")
            touched += overlaps(figure)
            part_tick_labels(figure)
            assert overlaps(figure) == 0
            assert sum(tick.label1.get_visible() for tick in axis.xaxis.get_major_ticks()) > 0
    # Without parting them some did.
    assert touched > 0
