"""benchmarks/judgement.py: each mix-up can be made of a subject."""

from __future__ import annotations

import numpy as np
import pytest

from programs import benchmark

judgement = benchmark("judgement")
KINDS = {mixup.make: mixup for mixup in judgement.MIXUPS.values()}


@pytest.fixture(scope="module")
def case():
    subject = judgement.make_subject(1001)
    return judgement.Case.of(subject, judgement.estimate(subject))


@pytest.mark.slow
@pytest.mark.parametrize("mixup", KINDS.values(), ids=[make.__name__ for make in KINDS])
def test_a_mixup_changes_what_the_checks_are_told(case, mixup) -> None:
    made = mixup.make(case, mixup.sizes[-1])
    before, after = (
        [
            *(np.concatenate([trial.trial.corners.corners.ravel(), [trial.force_n]]) for trial in one.pushes.trials),
            *(part.difference for part in one.fit.residuals),
            *(corners.corners for corners, _ in one.subject.rest.values()),
        ]
        for one in (case, made)
    )
    assert any(a.shape != b.shape or np.abs(a - b).max() > 1e-3 for a, b in zip(before, after, strict=True))
