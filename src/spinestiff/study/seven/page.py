"""The study's page as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom

from spinestiff.study.paper import SUBJECTS
from spinestiff.study.seven.account import TIMED, cost_rows, cost_words, found_by, time_goal
from spinestiff.study.seven.discussion import differing, points_of_conclusions, points_of_results
from spinestiff.study.seven.goals import (
    PUSHES,
    Goal,
    cobb_errors,
    coverage,
    frames_of,
    goals,
    mean,
    median,
    motions,
    places,
)
from spinestiff.study.seven.participants import (
    COUNT_OTHERS,
    FORCE_N,
    MAIN,
    MOST_TILT_DEG,
    TABLES_MESH,
    TISSUE_SCALE,
    others,
)
from spinestiff.study.seven.tables import NOTHING, PaperTable, paper_tables
from spinestiff.study.wording.numbers import fixed, listed
from spinestiff.subject.outcome_parts import Quantity
from spinestiff.subject.study_outcome import SubjectOutcome
from spinestiff.words import counted

FORMS = {
    "signed": "signed largest angle (the paper's)",
    "fixed_levels": "fixed levels",
    "tilt": "largest change of tilt",
}
PREDICTORS = {
    "rest": "no motion",
    "default": "default",
    "extrapolation": "tracking extrapolated by force",
    "single_ratio": "a single ratio",
    "fit": "estimate",
    "forecast": "forecast",
    "truth": "true ratios",
}


@dataclass(frozen=True)
class Picture:
    """A figure of the page: the paper's number, its place from the page, what it shows."""

    number: str
    path: str
    words: str


@dataclass(frozen=True)
class Pictures:
    """The figures of a page.

    Attributes
    ----------
    shown : all, in order.
    kept : numbers of those that were not drawn for this page but lay beside it.
    undrawn : those of the seven that have an outcome and could not be drawn.
    """

    shown: tuple[Picture, ...] = ()
    kept: tuple[str, ...] = ()
    undrawn: tuple[str, ...] = ()


def page_text(
    first: Sequence[SubjectOutcome | None],
    further: Sequence[SubjectOutcome],
    pictures: Pictures,
    date: str,
    program: str,
    mesh: str,
    lacking: Mapping[str, str | None],
) -> str:
    """The whole page.

    Parameters
    ----------
    first : the seven, None where there is no outcome. further : the others that there are.
    lacking : participants by name: why the last run found no outcome; None where there is none and nothing was noted.
    date : of the page. program : ``subject.program.program_of_numbers`` of whoever writes it.
    mesh : of the estimates.
    """
    there = [one for one in first if one is not None]
    parts = [
        "# The study: the paper's seven",
        "<!-- written by spinestiff study seven; not by hand -->",
        f"Written on {date} from the outcomes of `spinestiff study seven DIR --mesh {mesh}`. "
        f"Estimates are on the {mesh} mesh, Tables 3 "
        f"and 7 on the {TABLES_MESH} one. The page holds "
        f"**{len(there)} of the {len(SUBJECTS)} subjects** and **{len(further)} of the {COUNT_OTHERS} others** "
        "(`--others`)."
        + (
            ""
            if len(there) == len(SUBJECTS)
            else " The study is not finished: the same command goes on where it ended."
        ),
        found_by([*there, *further], program),
        *_without(lacking),
        ABOUT,
        "## Goals",
        "The limits are fixed in the program, whatever is found.",
        _goals(there, further),
        GOALS_ABOUT,
    ]
    if there:
        parts += ["## The paper's tables", TABLES_ABOUT]
        for table in paper_tables(first):
            parts += [f"### Table {table.number}: {table.title}", _markdown(table)]
            rows = differing(table)
            if rows:
                parts += ["Rows that differ by more than a tenth, in the average or in the mean over subjects:"]
                parts.append("\n".join(f"- {row}" for row in rows))
        missing = [
            f"- {one.name}: {line}." for one in (*there, *further) for line in (*_unpredicted(one), *one.missing)
        ]
        if missing:
            parts += ["### What could not be found", "\n".join(missing)]
        parts += ["## Figures", *_figures(pictures)]
    for title, outcomes in (("The seven", there), ("The others", further)):
        if outcomes:
            parts += [f"## Held-out frames: {title.lower()}", HELD_OUT_ABOUT, _predictors(outcomes), _cobb(outcomes)]
    if further:
        parts += ["## The others, one by one", _their_forces(further), _one_by_one(further)]
    for title, outcomes in (("Intervals", there), ("Intervals: the others", further)):
        if outcomes:
            parts += [f"## {title}", _intervals(outcomes)]
    if there:
        parts += ["## The paper's discussion (6.1), point by point", _listed(points_of_results(there))]
        parts += ["## The paper's conclusions (6.2), point by point", _listed(points_of_conclusions(there))]
        parts += ["## Forward test", _forward(first), "## Time", _time(there, further)]
    return "\n\n".join(parts) + "\n"


ABOUT = f"""All of it is synthetic. A subject is a folder of DICOM radiographs after a column of the paper's Table 2
(age, sex, height, kind of curve, Cobb angle with its sign, force with its side) with Table 4's ratios as truth. It
goes through `track`, `personalise`, `estimate` and `assess` like any other. What it is made of, the estimate does
not know:

- a secondary curve beside the first one, of a fourth to a half of its deflection;
- a tissue mesh of about 15,000 nodes that shares no point with the estimator's two (3,041 and 10,309);
- discs with another law, a moment k (a + (θ/θ₀)²) θ with a of 0.3 to 0.7 and θ₀ of 2° to 5°; the true ratio is the
  one at which linear discs store as much energy under the largest force;
- belt and shoulder pad that are springs and give by up to 4° and 4 mm;
- forces as a gauge with errors of 2 % and 1.5 N tells them, rib levels as they are felt, with an error of a fifth of a
  level (standard deviations);
- rendered radiographs with noise, scatter and motion blur, corners set by hand in one frame and tracked through the
  others;
- a geometry that is off: after personalisation the spine is bent away smoothly until its corners miss the rest
  radiograph by 2.39 ± 0.3 mm (the paper's mean).

What truth and estimator share: the template (of the subject's age, sex and height; subjects made until 2026-11-29 are
the girl of 13 scaled to the height, as estimates found until then were), the tissue's linear law and homogeneity, the
ribs' joints, the wall, the point from which X-rays project. And the estimate does not know the errors, but how large
such errors are: those of gauge, felt ribs and marks are drawn with the standard deviations of its
[priors](estimation.md), and the covariance of the geometry's error, with its size, which the rest radiograph shows, is
added to the geometry's own. So intervals are tried where errors are as large as they are taken to be.

Ratios: the paper's default tissue is not public. Here a ratio of 1 is the tissue at which the paper's seven bodies
show the force per degree that was measured with the paper's set-up
([how](validation.md#youngs-modulus-of-the-default-tissue)): 204.5 kPa on the fine mesh, found with the girl of 13
scaled to their heights (with bodies of their age and sex it would be 168.5 kPa). So the truth is Table 4's
ratio of tissue times {TISSUE_SCALE:.3f} over the package's default of 150 kPa, and Table 4's ratio of bending as it
is.

Pushes: seven frames at the rib of the curve's apex (6.1 thoracic, 9.9 thoracolumbar, 10 lumbar; the paper does not
tell), two for training (2/3 and all of the force) and one for validation (5/6). The paper's validation pose lay
between its training poses as well: the default's errors in Table 5 agree to 1 % in the mean. Beyond the paper: a
frame at 5/6 of the force at another rib, two levels away, and one from the other side. In all of them pelvis and
shoulder are where the training frames and their own marks say, never where vertebrae would have them."""

TABLES_ABOUT = """Lines "paper" are printed, "ours" found, "truth" what the subjects were made of. Averages are
those of the paper's tables (sizes in Tables 2, 3 and 6), over the subjects for which a line has a number; lines "paper"
and "truth" are averaged over the subjects for which the line "ours" below them has one. All averages are taken anew
from the columns, and may differ from the printed ones in the last digit. Lines have the paper's names; ours are by the
weighed fit, whose ratio of bending scales the 20 joints between ribs and sternum, too, and whose ratio of tissue scales
both Lamé parameters."""

HELD_OUT_ABOUT = """Corner RMSE, mm, median (largest). "Place" is where a corner is, "motion" how far it went since
the unloaded frame: the geometry's error is in the first alone. "Forecast" is the estimate with the errors that the
training frames and the unloaded frame show; extrapolated tracking starts at the unloaded frame, too, and so is to be
compared with it. "A single ratio" scales all stiffnesses alike, fitted in the same way. Each line is of the subjects
that have it; goals compare two of them over the subjects that have both. Tracking reversed for a push
from the other side is a hard rival here: a synthetic body's halves mirror each other, and where the curve is mild
and the answer in proportion to the force, it moves to the other side just as far. People's halves do not."""

GOALS_ABOUT = """The change of the Cobb angle is judged in two forms, by the same limits. *Between fixed levels*: the
two end vertebrae of the curve are chosen in the picture at rest, and the angle between these two is measured again
under force, as a patient's curve is followed from visit to visit. *As signed largest angle*, the paper's form: in each
picture anew the largest angle between any two vertebrae, with the side of its convexity as sign. That angle may pass
from one curve to another: when a push straightens the main curve, a second one becomes the largest, and the number
jumps or changes its sign though no vertebra has moved far. Where radiograph and model do not jump alike, the whole jump
counts as error. The paper reports its 2.9° and 5° in its own form, so that it is this one to be compared with.

Both forms are judged twice. The *estimate* is the model at rest and under force: which of its angles is the largest
also depends on a geometry that is off by 2.39 mm. The *forecast* begins at the measured unloaded frame and turns each
vertebra as the estimate, corrected as below, lets expect. It is what the report shows a user as the expected angle.

Intervals that hold more than 99 % of the corners are too wide, those that hold less than 90 % too narrow. The forecast
corrects the estimate by the errors that the training frames and the unloaded frame show; the motion since the unloaded
frame shows what the estimated stiffness does by itself. The estimate's own places contain the geometry's error, which
extrapolated tracking, from the unloaded frame on, does not."""

FORWARD = """The change of the Cobb angle in Table 2 is a forward test of the paper's numbers: Table 4's ratios under
Table 2's forces, with nothing fitted but the median force per degree (of a girl of 13 scaled to the subjects'
heights). What moves it (supports, wall, the tissue's law, element) is measured row by row in
[forward tests](validation.md#forward-tests-that-nothing-was-fitted-to): the supports most."""


TIME_ABOUT = """CPU seconds a subject on one thread; other work on the machine changes them less than the clock's.
"Tables" are the gradients of Table 3 and the refits of Table 7."""


def _without(lacking: Mapping[str, str | None]) -> list[str]:
    """A paragraph on who has no outcome, or none of the last run, and why; none where all have one."""
    failed = [f"{name} ({reason})" for name, reason in lacking.items() if reason is not None]
    waiting = [name for name, reason in lacking.items() if reason is None]
    words = (
        [f"The last run failed for {'; '.join(failed)}; what is told of them is of an earlier one."] if failed else []
    )
    words += [f"No outcome, and no reason noted, of {listed(_ranges(waiting))}."] if waiting else []
    return [" ".join(words)] if words else []


def _ranges(names: Sequence[str]) -> list[str]:
    """Names that end in numbers, three and more in a row as "other-09 to other-30"."""
    rows: list[list[str]] = []
    for name in names:
        (kind, _, number), (before, _, last) = name.rpartition("-"), (rows[-1][-1] if rows else "").rpartition("-")
        if kind == before and int(number) == int(last) + 1:
            rows[-1].append(name)
        else:
            rows.append([name])
    return [words for row in rows for words in ([f"{row[0]} to {row[-1]}"] if len(row) > 2 else row)]


def _their_forces(further: Sequence[SubjectOutcome]) -> str:
    drawn = {one.name: abs(one.force_n) for one in others()}
    less = [one.name for one in further if round(drawn.get(one.name, 0.0) - abs(one.force_n), 1) > 0.0]
    return (
        f"Forces are drawn from {FORCE_N[0]:g} to {FORCE_N[1]:g} N; a push ends where it would turn two vertebrae by "
        f"more than {MOST_TILT_DEG:g}° against each other ({listed(less) or 'none of these'})."
    )


def _figures(pictures: Pictures) -> list[str]:
    words = []
    if pictures.undrawn:
        words.append(
            f"{counted(len(pictures.undrawn), 'subject')} could not be drawn ({listed(pictures.undrawn)}): the folder "
            "with radiographs and results is not beside the outcome, or is not as its run left it."
        )
    if pictures.kept:
        kept = listed(f"Fig. {number}" for number in pictures.kept)
        words.append(f"{kept}: of an earlier page, whose numbers may differ from those above.")
    shown = [f"Fig. {one.number}. {one.words}.\n\n![{one.words}]({one.path})" for one in pictures.shown]
    return [" ".join(words), *shown] if words else shown


def _markdown(table: PaperTable) -> str:
    head = ["", "", *table.columns, "average"]
    rows, last = [head, ["---"] * 2 + ["---:"] * (len(head) - 2)], ""
    for line in table.lines:
        rows.append(["" if line.label == last else line.label, line.whose, *line.cells, line.average])
        last = line.label
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


NO_TIME_GOAL = Goal("time", "", "no aim", None)


def _goals(first: Sequence[SubjectOutcome], further: Sequence[SubjectOutcome]) -> str:
    groups = [("the seven", (*goals(first), time_goal(first))), ("the others", (*goals(further), NO_TIME_GOAL))]
    groups = [group for group, outcomes in zip(groups, (first, further)) if outcomes]
    whole = {"the seven": len(first) == len(SUBJECTS), "the others": len(further) == COUNT_OTHERS}
    if not groups:
        return "Nothing was found yet."
    rows = []
    for row in zip(*(found for _, found in groups)):
        cells = [row[0].name]
        for goal, (group, _) in zip(row, groups):
            verdict = {None: "", True: ", met", False: ", **not met**"}[goal.met]
            verdict += " so far" if verdict and not whole[group] else ""
            cells.append(f"{goal.wanted}: {goal.found}{verdict}" if goal.wanted else goal.found)
        rows.append(cells)
    return _table(["goal", *(name for name, _ in groups)], rows)


def _unpredicted(one: SubjectOutcome) -> list[str]:
    """Predictors that have nothing to say of held-out frames, with the frames."""
    found = []
    for name, words in PREDICTORS.items():
        lacking = [where for push, where in PUSHES.items() for f in frames_of([one], push) if not places([f], name)]
        if lacking:
            found.append(f"Held-out frames: {words} predicts nothing for {', '.join(lacking)}")
    return found


def _spread(values: Sequence[float]) -> str:
    return NOTHING if not values else f"{fixed(median(values), 2)} ({fixed(max(values), 1)})"


def _predictors(outcomes: Sequence[SubjectOutcome]) -> str:
    rows = []
    for name, words in PREDICTORS.items():
        cells = [words]
        for push in PUSHES:
            frames = frames_of(outcomes, push)
            cells += [_spread(places(frames, name)), _spread(motions(frames, name))]
        rows.append(cells)
    head = ["predictor", *(f"{words}, {what}" for words in PUSHES.values() for what in ("place", "motion"))]
    return _table(head, rows)


def _cobb(outcomes: Sequence[SubjectOutcome]) -> str:
    """Errors of the Cobb angle's change in its three forms, and the intervals."""
    rows = []
    for push, where in PUSHES.items():
        frames = frames_of(outcomes, push)
        for form, words in FORMS.items():
            cells = [where, words]
            for model in ("default", "fit", "forecast", "truth"):
                errors = cobb_errors(frames, model, form)
                cells.append(NOTHING if not errors else f"{fixed(mean(errors), 1)} ({fixed(max(errors), 1)})")
            rows.append(cells)
    what = "change of the Cobb angle, error in degrees, mean (worst)"
    head = ["frame", what, "default", "estimate", "forecast", "true ratios"]
    inside = [
        f"{where} {fixed(100 * found, 1)} %"
        for push, where in PUSHES.items()
        if (found := coverage(frames_of(outcomes, push))) is not None
    ]
    return (
        _table(head, rows) + "\n\nHeld-out corners inside their 95 % intervals: " + (", ".join(inside) or NOTHING) + "."
    )


def _one_by_one(outcomes: Sequence[SubjectOutcome]) -> str:
    rows = []
    for one in outcomes:
        main = frames_of([one], MAIN)
        cells = [f"{one.name}: {one.curve}, {fixed(one.cobb_deg, 0, True)}°, {fixed(one.force_n, 0, True)} N"]
        for name in ("lateral_bending", "tissue"):
            cells.append(f"{one.truth[name]:.3g}: {one.ratios[name].value:.3g}")
        for predictor in ("default", "fit", "forecast"):
            cells.append(_one(places(main, predictor), 2))
        cells += [_one(cobb_errors(main, model), 1) for model in ("default", "fit")]
        rows.append([*cells, {None: NOTHING, True: "yes", False: "no"}[one.inside]])
    head = ["subject", "bending, true: found", "tissue, true: found", "RMSE default", "estimate", "forecast"]
    return _table([*head, "Cobb error (fixed levels) default", "estimate", "truth inside 95 % region"], rows)


def _one(values: Sequence[float], digits: int) -> str:
    return fixed(values[0], digits) if values else NOTHING


def _intervals(outcomes: Sequence[SubjectOutcome]) -> str:
    lines = []
    for name, words in (("lateral_bending", "Bending"), ("tissue", "Tissue")):
        held = [found for one in outcomes if (found := _held(one.ratios[name], one.truth[name])) is not None]
        without = len(outcomes) - len(held)
        errors = [abs(np.log(one.ratios[name].value / one.truth[name])) for one in outcomes]
        lines.append(
            f"- {words}: the truth lies in {sum(held)} of {len(held)} 95 % intervals"
            + (f", {without} more have none" if without else "")
            + f"{_by_chance(sum(held), len(held))}; the estimate is off by a factor of "
            f"{fixed(float(np.exp(np.median(errors))), 2)} in the median, {fixed(float(np.exp(max(errors))), 2)} "
            "at worst."
        )
    regions = [one.inside for one in outcomes if one.inside is not None]
    if regions:
        lines.append(
            f"- Both together: the truth lies in {sum(regions)} of {len(regions)} joint 95 % regions"
            + ("" if len(regions) == len(outcomes) else f", of {len(outcomes) - len(regions)} more it is not known")
            + f"{_by_chance(sum(regions), len(regions))}."
        )
    doubted = [f"{one.name} ({', '.join(dict.fromkeys(one.failed))})" for one in outcomes if one.failed]
    lines.append(
        f"- Results that are told as doubtful, and the checks that failed: {'; '.join(doubted) or 'none'}. Checks of "
        "single vertebrae are there to find a geometry that is off by millimetres."
    )
    return "\n".join(lines)


def _held(ratio: Quantity, truth: float) -> bool | None:
    """Whether an interval holds the truth; None without one."""
    if (ratio.low is None and not ratio.open_low) or (ratio.high is None and not ratio.open_high):
        return None
    above = ratio.open_low or ratio.low is None or ratio.low <= truth
    return above and (ratio.open_high or ratio.high is None or truth <= ratio.high)


def _by_chance(held: int, count: int) -> str:
    """How rarely 95 % intervals of independent subjects hold so few truths, where that is below one in five."""
    chance = float(binom.cdf(held, count, 0.95))
    return "" if chance >= 0.2 else f" (fewer than promised: by chance so few in {fixed(100 * chance, 1)} % of studies)"


def _forward(first: Sequence[SubjectOutcome | None]) -> str:
    both = [(one.change_deg, printed.change_deg) for one, printed in zip(first, SUBJECTS) if one is not None]
    ours, theirs = np.array(both).T
    off, none = (float(np.sqrt(np.mean(values**2))) for values in (ours - theirs, theirs))
    signs = int(np.sum(np.sign(ours) == np.sign(theirs)))
    return (
        f"{FORWARD} Here the signed angle is off by {fixed(off, 1)}° (root mean square over {len(both)}; no change at "
        f"all would be by {fixed(none, 1)}°), with the paper's sign in {signs}."
    )


def _time(first: Sequence[SubjectOutcome], further: Sequence[SubjectOutcome]) -> str:
    head = ["subject", "found on", *TIMED, "together"]
    tables = [_table(head, cost_rows(outcomes)) for outcomes in (first, further) if outcomes]
    return "\n\n".join([TIME_ABOUT, cost_words(first), *tables])


def _listed(points: Sequence[str]) -> str:
    return "\n".join(f"- {point}" for point in points)
