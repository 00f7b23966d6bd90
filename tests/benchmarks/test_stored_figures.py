"""Figures that benchmarks store: only where ``--write`` asks for it, and with what was not measured this time."""

from __future__ import annotations

import numpy as np
import pytest

from programs import benchmark
from spinestiff.files import read_json, write_json

WAY = {"pushes": 1, "page_s": 1.0, "annotation_s": 2.0}


def with_shown_view(monkeypatch, path):
    program = benchmark("shown_view")
    monkeypatch.setattr(program, "RESULTS", path)
    monkeypatch.setattr(program, "synthetic", lambda: [("curves", "frontal", np.zeros((8, 8)))])
    return program


def with_annotation_page(monkeypatch, path):
    program = benchmark("annotation_page")
    monkeypatch.setattr(program, "RESULTS", path)
    monkeypatch.setattr(program, "write_folder", lambda folder, side, count: None)
    monkeypatch.setattr(program, "measured", lambda folder, place, window: {"window": window})
    return program


def with_workbench_way(monkeypatch, path):
    program = benchmark("workbench_way")
    monkeypatch.setattr(program, "RESULTS", path.parent)
    monkeypatch.setattr(program, "annotation_seconds", lambda path: {})
    monkeypatch.setattr(program, "whole_way", lambda pushes, marking: WAY)
    return program


@pytest.mark.parametrize(
    ("made", "file"),
    [
        (with_shown_view, "shown_view.json"),
        (with_annotation_page, "annotation_page.json"),
        (with_workbench_way, "workbench_way.json"),
    ],
)
def test_a_run_without_flags_stores_nothing(tmp_path, monkeypatch, made, file) -> None:
    path = tmp_path / file
    program = made(monkeypatch, path)
    write_json(path, {"before": 1})
    monkeypatch.setattr("sys.argv", [file])
    program.main()
    assert read_json(path) == {"before": 1}
    monkeypatch.setattr("sys.argv", [file, "--write"])
    program.main()
    assert read_json(path).keys() > {"before"} if made is with_shown_view else "date" in read_json(path)


def test_figures_of_real_radiographs_stay_where_there_are_none_at_hand(tmp_path, monkeypatch) -> None:
    path = tmp_path / "shown_view.json"
    program = with_shown_view(monkeypatch, path)
    write_json(path, {"real, frontal": {"right": 6}, "curves, frontal": {"WRONG": 9}})
    monkeypatch.setattr("sys.argv", ["shown_view", "--write"])
    program.main()
    found = read_json(path)
    assert found["real, frontal"] == {"right": 6} and found["curves, frontal"] == {"undecided": 1}
