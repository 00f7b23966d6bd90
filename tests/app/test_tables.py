"""Tables and JSON that commands print."""

from __future__ import annotations

import csv
import json
import re
import tomllib
from pathlib import Path

import pytest

from spinestiff import versions
from spinestiff.app import doctor, tables
from spinestiff.mechanics import factor
from spinestiff.mechanics.cudss import GpuFailure
from spinestiff.mechanics.factor import default_backend
from spinestiff.study.repeatability import Repeatability, Scatter
from spinestiff.study.report.estimate_content import _gain
from spinestiff.study.seven.tables import paper_tables
from spinestiff.study.summary import estimate_csv
from spinestiff.subject.assessment_outcome import HeldOutFrame
from spinestiff.subject.estimate_outcome import BudgetRecord, Estimate, PlainStiffness, PriorChangeRecord, RatioEstimate
from spinestiff.subject.outcomes import FrameProposal
from spinestiff.subject.program import program
from spinestiff.verification.outcome import Check
from study_outcomes import outcome

NAN = float("nan")
RATIOS = {
    "lateral_bending": RatioEstimate.of(0.10234, (0.0952, 0.1101), (False, False), False),
    "tissue": RatioEstimate.of(0.005, (0.005, 0.0123), (True, False), True),
}
LEVEL = {**RATIOS["lateral_bending"].scaled(120.0).model_dump(), "unit": "N m/rad", "ratio": "lateral_bending"}
NONE = {"value": 3.2154, "low": None, "high": None, "unit": "kPa", "ratio": None}
CHANGE = {"signed": -5.0, "fixed_levels": -5.1, "tilt": -7.04, "levels": ("T5", "T9"), "tilt_levels": ("T6", "L1")}
ASSESSMENT = {
    "push": "main",
    "frame": 6,
    "force_n": 60.0,
    "rmse_mm": {
        "forecast": 0.7,
        "rest": 9.0,
        "default": 7.126,
        "fit": 1.234,
        "fitted_supports": 0.5,
        "extrapolation": None,
        "single_ratio": 2.0,
        "truth": None,
    },
    "cobb_change_deg": {"measured": CHANGE, "fit": None},
}


@pytest.fixture
def printed(capsys, monkeypatch):
    def show(table, width=120):
        monkeypatch.setattr(tables, "WIDTH", width)
        tables.show(table)
        return capsys.readouterr().out

    return show


def row_of(text, start):
    (line,) = [line for line in text.splitlines() if line.startswith(start)]
    return re.split(r" {2,}", line.strip())


def estimate(**changed):
    plain = {
        "lateral_bending_thoracic": PlainStiffness.model_validate(LEVEL),
        "lateral_bending_lumbar": PlainStiffness.model_validate(LEVEL),
        "tissue_young": PlainStiffness.model_validate(NONE),
    }
    given = {"status": "CONVERGED", "determined": "weakly determined", "parameters": tuple(RATIOS), "ratios": RATIOS}
    return Estimate.model_construct(**{"method": "weighed", **given, "plain": plain, **changed})


def test_estimate(printed):
    """Digits as the interval leaves them, open ends as such, and how far each is determined."""
    text = printed(tables.estimate_table(estimate()))
    assert "Estimate: weakly determined" in text
    assert row_of(text, "ratio: lateral_bending")[1:] == ["0.102", "0.0952 to 0.110", "determined"]
    assert row_of(text, "ratio: tissue")[1:] == ["≤ 0.005", "≤ 0.005 to 0.012", "weakly determined, at bound"]
    assert row_of(text, "lateral bending of a thoracic level")[1:] == ["12.3", "11.4 to 13.2", "N m/rad"]
    assert row_of(text, "Young's modulus")[1:] == ["3.2", "kPa"]
    assert text.index("thoracic level") < text.index("ratio: ")  # plain units come first


def test_a_doubtful_estimate_says_so_above_its_numbers(printed):
    text = printed(tables.estimate_table(estimate().model_copy(update={"status": "DOUBTFUL"})))
    assert text.index("Estimate: doubtful") < text.index("lateral_bending")
    assert row_of(text, "ratio: lateral_bending")[-1] == "doubtful"
    assert row_of(text, "ratio: tissue")[-1] == "doubtful, at bound"
    assert "determined" not in text


def test_the_paper_s_estimate_says_that_it_has_no_intervals(printed):
    ratios = {name: RatioEstimate.of(one.value, (NAN, NAN), (False, False), False) for name, one in RATIOS.items()}
    plain = {name: PlainStiffness.model_validate({**LEVEL, "low": None, "high": None}) for name in ("a", "b")}
    found = estimate(method="paper", ratios=ratios, determined="not determined")
    text = printed(tables.estimate_table(found))
    assert "Estimate: no intervals" in text and "determined" not in text
    # So it is in a table for other programs.
    rows = csv.DictReader(estimate_csv(found.model_copy(update={"plain": plain})).splitlines())
    assert {row["determined"] for row in rows} == {"no intervals"}
    assert row_of(text, "ratio: lateral_bending")[1:] == ["0.10", "not available", "no intervals"]


def test_the_report_names_what_nobody_can_measure():
    """Of tissue most is gained by knowing how it resists a change of volume, which is not all that a model lacks."""
    rows = [
        BudgetRecord(name=name, alone={"tissue": 0.1}, without={"tissue": without})
        for name, without in (("tissue's volume", 0.1), ("model discrepancy", 0.15), ("trunk size", 0.18))
    ]
    found = _gain(estimate(sd_log={"tissue": 0.2}, budget=tuple(rows)), "tissue")
    assert found["unmeasurable"] == "the tissue’s resistance to a change of volume"
    assert (found["known"], found["what"], found["then"]) == ("1.22", "the trunk’s size", "1.42")


def by_ratio(bending, tissue):
    return {"lateral_bending": bending, "tissue": tissue}


def test_the_variance_budget_fits_a_terminal_the_most_costly_unknown_first(printed):
    """Factors are exp(1.96 sd)."""
    rows = {
        "tissue's volume": ((0.2, 0.05), (0.4, 0.2)),
        "trunk size": ((0.1, 0.19), (0.4, 0.07)),
        **{f"other {i}": ((0.1, 0.04), (0.4, 0.2)) for i in range(8)},
    }
    budget = [BudgetRecord(name=name, alone=by_ratio(*a), without=by_ratio(*w)) for name, (a, w) in rows.items()]
    sds = {"sd_log": by_ratio(0.4, 0.2), "sd_log_tracking": by_ratio(0.1, 0.04)}
    text = printed(tables.budget_table(estimate(budget=tuple(budget), **sds)), 80)
    assert row_of(text, "the trunk's size")[1:] == ["1.22", "2.2", "1.45", "1.15"]
    assert row_of(text, "the tissue's resistance")[1:] == ["1.48", "2.2", "1.10", "1.48"]
    assert text.index("the trunk's size") < text.index("the tissue's resistance") < text.index("other 0")
    assert "2 more, that change less, in estimate.json" in " ".join(text.split()) and "other 6" not in text
    assert max(map(len, text.splitlines())) <= 80


def test_other_priors_are_told_with_what_they_make_of_each_ratio(printed):
    changes = [
        PriorChangeRecord(name=name, factor=factor, ratios=by_ratio(*ratios), sd_log=by_ratio(*sds))
        for name, factor, ratios, sds in (
            ("push height", 0.5, (0.1024, 0.005), (0.4, 0.2)),
            ("tissue's volume", 2.0, (0.08, 0.006), (0.5, 0.3)),
            *((f"other {i}", 2.0, (0.10234, 0.005), (0.4, 0.2)) for i in range(5)),
        )
    ]
    found = estimate(prior_changes=tuple(changes), sd_log=by_ratio(0.4, 0.2))
    text = printed(tables.priors_table(found), 80)
    assert row_of(text, "all as they are")[1:] == ["0.10 (2.2)", "0.0050 (1.48)"]
    assert row_of(text, "the tissue's resistance")[1:] == ["doubled", "0.080 (2.7)", "0.0060 (1.80)"]
    assert row_of(text, "the push's height")[1:] == ["halved", "0.10 (2.2)", "0.0050 (1.48)"]
    assert text.index("the tissue's resistance") < text.index("the push's height") < text.index("other 0")
    assert "1 more, that change less, in estimate.json" in " ".join(text.split()) and "other 4" not in text
    assert max(map(len, text.splitlines())) <= 80


def test_assessment(printed):
    text = printed(tables.assessment_table([HeldOutFrame.model_validate(ASSESSMENT)]))
    (line,) = [line for line in text.splitlines() if line.startswith("main 6")]
    # Nobody extrapolates or knows the truth here, so that there are no columns for it.
    assert line.split() == ["main", "6", "60", "9.00", "7.13", "1.23", "0.70", "0.50", "2.00", "-7.0", "-"]
    upper, lower = CHANGE["tilt_levels"]
    assert f" {upper}–{lower}" in text.splitlines()[text.splitlines().index(line) + 1]
    surely = {**ASSESSMENT, "cobb_change_deg": {"measured": {**CHANGE, "sds": (3.0, 2.0, 1.0)}, "fit": None}}
    assert " -7.0±2.0 " in printed(tables.assessment_table([HeldOutFrame.model_validate(surely)]))
    assert "truth" not in text and "pol." not in text
    whole = {**ASSESSMENT, "rmse_mm": {**ASSESSMENT["rmse_mm"], "truth": 1.5}}
    assert "truth" in printed(tables.assessment_table([HeldOutFrame.model_validate(whole)]))


def test_repeatability(printed):
    scatter = Scatter(0.0123, 0.0101, 0.0456, 5, 0.0111, 1.1, 1.2, 0.5, 0, 1.11)
    text = printed(tables.repeatability_table(Repeatability("visits", {"lateral_bending": scatter}, (), ())), 80)
    assert re.search(r"smallest *\n.*\bchange +expected", text) and "lateral bending" in text
    assert row_of(text, "lateral bending")[1:] == ["0.012", "0.010 to 0.046", "0.011", "× 1.1", "× 1.2", "0.5"]


def test_cobb(printed):
    text = printed(tables.cobb_table([("main [1]", "+12.0 deg (T5-L1)", "-1.0", "-2.0", "-3.0")]))
    lines = [line.split() for line in text.splitlines()[-2:]]
    assert lines == [["main", "[1]", "+12.0", "deg", "-1.0", "-2.0", "-3.0"], ["(T5-L1)"]]


def test_checks(printed):
    checks = [Check("energy [a]", "independent", 1e-12, 1e-9, True), Check("b", "independent", 2.0, 1e-9, False)]
    text = printed(tables.check_table(checks))
    assert "1 of 2 independent checks passed" in text
    assert row_of(text, "energy [a]") == ["energy [a]", "independent", "1.0e-12", "1e-09", "passed"]
    assert row_of(text, "b")[-1] == "FAILED"


@pytest.mark.parametrize(("error", "shown"), [(0.5, 0.5), (float("inf"), "inf"), (float("nan"), "nan")])
def test_a_check_as_json(capsys, error, shown):
    record = tables.check_record(Check("a", "independent", error, 1e-9, False))
    assert record == {"name": "a", "kind": "independent", "error": shown, "tolerance": 1e-9, "passed": False}
    tables.show_json([record])
    assert json.loads(capsys.readouterr().out) == [record]


def test_doctor(printed, monkeypatch):
    found = doctor.examine()
    text = "".join(printed(table) for table in doctor.doctor_tables(found))
    assert row_of(text, "spinestiff  ")[1] == program()
    assert row_of(text, "sparse solver in use")[1] == default_backend()
    assert "nodes" in row_of(text, "template mesh 'coarse'")[1]
    for name in versions.LIBRARIES:
        assert row_of(text, f"{name} ")[1]
    json.dumps(found, allow_nan=False)
    monkeypatch.setattr(doctor, "installed", lambda name: None)
    bare = "".join(printed(table) for table in doctor.doctor_tables(doctor.examine()))
    assert bare.count("MISSING: pip install it") == len(versions.LIBRARIES)
    assert row_of(bare, "dicom") == ["dicom", "JPEG Lossless radiographs", "not installed: python-gdcm"]
    assert bare.count("not installed: ") == len(versions.EXTRAS)


def test_doctor_without_the_solver_that_is_asked_for(printed, monkeypatch):
    def none():
        raise GpuFailure('no GPU; pip install "spinestiff[gpu]"')

    monkeypatch.setattr(factor, "require_gpu", none)
    factor._require_gpu.cache_clear()
    monkeypatch.setenv("SPINESTIFF_SOLVER", "cudss")
    text = " ".join(printed(doctor.doctor_tables(doctor.examine())[0]).split())
    assert "NONE: the sparse solver 'cudss' has no GPU to use: no GPU; pip install \"spinestiff[gpu]\"" in text


def test_doctor_knows_every_extra_and_what_it_installs():
    content = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))
    written = {
        name: tuple(re.match(r"[\w-]+", line).group() for line in lines)
        for name, lines in content["project"]["optional-dependencies"].items()
    }
    assert {extra.name: extra.libraries for extra in versions.EXTRAS} == written
    assert all(extra.use for extra in versions.EXTRAS)


LONG = "thoracic-left-of-visit-2"


@pytest.mark.parametrize("push", ["rib-8", LONG])
def test_tables_fit_eighty_characters_without_losing_a_character(printed, push):
    """Numbers are whole; names may be folded."""
    frame = {**ASSESSMENT, "push": push, "frame": 12, "force_n": 120.0}
    frame["rmse_mm"] = dict.fromkeys(ASSESSMENT["rmse_mm"], 12.345)
    frame["cobb_change_deg"] = {"measured": CHANGE, "fit": {**CHANGE, "tilt": -17.04}}
    support = {"mm": 12.345, "degrees": -1.25}
    proposal = FrameProposal.model_construct(
        push=push, frame=12, force_n=120.0, sharpness=0.98, contrast_to_noise=12.3, vertebrae=17, tracking_mm=0.35,
        supports={"pelvis": support, "shoulder": {"mm": 3.25, "degrees": None}}, role="validation", proposed="training",
    )  # fmt: skip
    angle = "12.1° ± 14.4° (T10–L3, endplates, right-convex)"
    change = "−23.7° ± 16.3° (T10–T11 to T12–L3)"
    shown = [
        (tables.estimate_table(estimate()), ("0.0952 to 0.110", "≤ 0.005 to 0.012")),
        (tables.assessment_table([HeldOutFrame.model_validate(frame)]), ("12.35", "-17.0", "120")),
        (tables.frames_table([proposal]), ("12.3, -1.2°", "0.98", "validation", "training")),
        (tables.cobb_table([(f"{push} frame 12, 120 N", angle, *[change] * 3)]), ("12.1° ± 14.4°", "−23.7° ± 16.3°")),
        (tables.check_table([Check("A1 " + 9 * "long name ", "independent", 1e-12, 1e-9, True)]), ("1.0e-12", "1e-09")),
    ]
    for table, whole in shown:
        text = printed(table, 80)
        assert "…" not in text
        assert max(len(line.rstrip()) for line in text.splitlines()) <= 80
        for words in whole:
            assert words in text, (words, text)


def test_the_paper_s_tables_come_in_parts_where_a_line_is_too_short_for_all_subjects(capsys, monkeypatch):
    """No cell is broken, and each part has the labels of all lines."""

    def parts(table, width):
        monkeypatch.setattr(tables, "WIDTH", width)
        tables.show_paper_table(table)
        text = capsys.readouterr().out
        assert max(len(line.rstrip()) for line in text.splitlines()) <= width
        assert "…" not in text
        return text.split(f"Table {table.number}: ")[1:]

    columns = [f"# {number}" for number in range(1, 8)] + ["average"]
    several = {2: 2, 4: 3, 6: 2}
    for table in paper_tables([outcome(number) for number in range(1, 8)]):
        narrow = parts(table, 80)
        assert len(narrow) == several.get(table.number, 1)
        assert [head for part in narrow for head in re.findall(r"# \d|average", part)] == columns
        for part in narrow:
            # A title may say on which mesh ours are.
            assert [part.count(whose) - table.title.count(whose) for whose in ("paper", "ours")] == [
                sum(line.whose.startswith(whose) for line in table.lines) for whose in ("paper", "ours")
            ]
        words = "\n".join(narrow)
        for line in table.lines:
            assert all(cell in words for cell in (*line.cells, line.average))
        assert len(parts(table, 160)) == 1


@pytest.mark.parametrize(
    ("path", "lines"),
    [
        ("IM1", ["IM1"]),
        ("DICOM/PA000001/ST000001/SE000003/IM000001", ["DICOM/PA000001/ST000001/", "SE000003/IM000001"]),
        ("a" * 30 + "/b", ["a" * 30 + "/", "b"]),
        ("two words/and a file of a very long name", ["two words/", "and a file of a very long name"]),
    ],
)
def test_a_path_is_broken_behind_its_folders(path, lines):
    assert tables.broken(path).split("\n") == lines


def test_names_from_files_are_no_markup(printed):
    record = HeldOutFrame.model_validate({**ASSESSMENT, "push": "[red]x[/red]"})
    assert "[red]x[/red] 6" in printed(tables.assessment_table([record]))
