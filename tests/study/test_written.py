"""What an estimate's record says beside its numbers."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from spinestiff.anatomy.template import template_torso
from spinestiff.estimation.unknowns import ACTS
from spinestiff.study import written
from spinestiff.study.written import mesh_notes


@pytest.fixture(scope="module")
def coarse():
    return template_torso(157.0, "coarse")


def test_a_coarse_mesh_is_called_a_quick_look_with_what_it_does_to_the_ratios(coarse):
    (note,) = mesh_notes(coarse, "weighed")
    assert note.startswith(f"a quick look: the tissue's mesh is coarse ({len(coarse.tissue.rest_positions)} nodes)")
    assert "tissue comes out lower" in note and "bending" in note and "the intervals allow for" in note
    assert note.endswith("run again without --mesh coarse")


def test_the_paper_s_method_has_no_intervals_that_allow_for_it_and_own_bones_have_one_mesh(coarse):
    (note,) = mesh_notes(coarse, "paper", own=True)
    assert "intervals" not in note
    assert note.endswith("import the bones with a smaller --spacing")


def test_a_fine_mesh_needs_no_such_note():
    assert mesh_notes(template_torso(157.0, "fine"), "weighed") == ()


def test_a_p_value_that_there_is_not_is_none():
    """JSON has no NaN, and a record refuses one."""
    found = SimpleNamespace(
        nuisances=(),
        acts=np.zeros((0, len(ACTS))),
        budget=None,
        visit_sd=np.zeros(1),
        annotation_sd=np.zeros(1),
        changes=(),
        best_known=None,
        p_value=float("nan"),
        tracking_factor=1.0,
        outlying=(),
    )
    fit = SimpleNamespace(weighed=found, names=("tissue",))
    assert written._weighed(SimpleNamespace(training=()), fit)["p_value"] is None
    found.p_value = 0.25
    assert written._weighed(SimpleNamespace(training=()), fit)["p_value"] == 0.25
