"""Cohorts of tiny subjects, and processes that find the quick runner."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from cohort_runners import QUICK, cohort_of
from spinestiff.cohort.asked import Cohort
from spinestiff.cohort.marker import Order
from spinestiff.cohort.places import place_of
from spinestiff.cohort.worker import Task


@pytest.fixture(autouse=True)
def findable(monkeypatch):
    tests = str(Path(__file__).parents[1])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([tests, os.environ.get("PYTHONPATH", "")]))


@pytest.fixture
def made(tmp_path):
    """``made(count, sub_002="die")``: a cohort; its output is beside it."""

    def make(count: int, settings: dict | None = None, **trouble: str) -> Cohort:
        flags = tmp_path / "flags"
        flags.mkdir(exist_ok=True)
        names = cohort_of(tmp_path / "in", count, **trouble)
        order = Order(runner=QUICK, settings={"flags": str(flags), **(settings or {})}, version="1")
        return Cohort(tmp_path / "in", tmp_path / "out", names, order)

    return make


@pytest.fixture
def task(made):
    """One participant's task and its folders."""
    cohort = made(1)
    found = Task(participant="sub-001", source=str(cohort.source), target=str(cohort.target), order=cohort.order)
    return found, place_of(cohort.source, cohort.target, "sub-001")
