"""One subject of the study."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from spinestiff.errors import FitError
from spinestiff.files import write_json
from spinestiff.study.seven import subject
from spinestiff.study.seven.participants import seven
from spinestiff.study.seven.subject import _make, force_changes
from spinestiff.study.synthetic.subject import truth_path


def test_a_subject_that_is_there_is_not_told_as_made(tmp_path):
    recipe, folder, lines = seven()[0].recipe(), tmp_path / "subject-1", []
    folder.mkdir()
    (folder / "subject.json").touch()
    write_json(truth_path(folder), {"recipe": recipe.as_record()})
    assert _make(folder, recipe, lines.append) is False
    assert lines == []


@pytest.fixture
def refits(monkeypatch):
    """Refits whose ratios follow the force exactly, without a model; a force in ``failing`` has none."""
    failing = set()

    def refit(force, start=None):
        if force in failing:
            raise FitError("stalled")
        return SimpleNamespace(ratios=SimpleNamespace(as_dict=lambda: {"tissue": 0.02 * force}))

    estimate = SimpleNamespace(orientation="procrustes", method="weighed", population=None)
    basis = SimpleNamespace(torso=None, estimate=estimate, refit=refit)
    monkeypatch.setattr(subject, "basis_of", lambda visit: basis)
    monkeypatch.setattr(subject, "with_force", lambda visit, force: force)
    monkeypatch.setattr(subject, "pushes_on", lambda force, *_: force)
    return failing


def changes_of(lines=None):
    return force_changes(None, (lines if lines is not None else []).append)


def test_a_tenth_of_force_is_a_tenth_of_stiffness(refits):
    lines = []
    assert changes_of(lines) == ({"tissue": 10.0}, ())
    assert lines == [
        f"tables: refit with {what}" for what in ("the forces as they are", "-10 % of force", "+10 % of force")
    ]


def test_a_refit_that_is_not_found_loses_its_own_sign_alone(refits):
    refits.add(1.1)
    assert changes_of() == ({"tissue": 10.0}, ("Table 7: no refit with +10 % of force (stalled)",))


def test_without_the_refit_that_others_are_compared_with_there_are_no_changes(refits):
    refits.add(1.0)
    assert changes_of() == ({}, ("Table 7: no refit with the forces as they are (stalled)",))
