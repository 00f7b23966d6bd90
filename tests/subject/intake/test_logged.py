"""A force log beside the radiographs of a push: by which times, and what is said of them."""

from __future__ import annotations

import numpy as np
import pytest

from hospital import export
from spinestiff.errors import SubjectError
from spinestiff.subject.intake.force_log import ForceLog
from spinestiff.subject.intake.logged import put_beside


@pytest.mark.parametrize(("tag", "doubted"), [("AcquisitionTime", False), ("ContentTime", True)])
def test_times_of_content_stand_in_for_those_of_the_acquisition_and_are_told(tmp_path, tag, doubted):
    files = [export(tmp_path / f"f{i}", time=None, InstanceNumber=i + 1, **{tag: f"10100{i}"}) for i in range(4)]
    log = ForceLog(np.linspace(0.0, 5.0, 51), np.linspace(0.0, 50.0, 51))
    logged = put_beside(log, files, "left-8", 0.5)
    assert logged.times_s == pytest.approx([0.0, 1.0, 2.0, 3.0])
    assert logged.forces_n == [5.0, 15.0, 25.0, 35.0]
    assert ("ContentTime, which may be that of processing" in logged.doubt) is doubted
    assert bool(logged.doubt) is doubted


def test_frames_beyond_a_log_are_told_with_the_limit(tmp_path):
    files = [export(tmp_path / f"f{i}", time=f"10100{i}", InstanceNumber=i + 1) for i in range(4)]
    log = ForceLog(np.linspace(0.0, 5.0, 51), np.linspace(0.0, 50.0, 51))
    with pytest.raises(SubjectError, match=r"lie 1\.5 s beyond .* wanted a log around them, or at most 1 s beyond it"):
        put_beside(log, files, "left-8", 3.5)
