"""benchmarks/plan.py: what is proposed becomes pushes that can be made, and logs become medians."""

from __future__ import annotations

import pytest

from programs import benchmark
from spinestiff.subject.plan_outcome import PlannedPush
from spinestiff.subject.records import PushRecord

benchmark("coverage_subjects")
plan = benchmark("plan")


def proposed(side, level, force_n):
    return PlannedPush(side=side, level=level, force_n=force_n, radiographs=1, expected_factor=2.0, factors={})


def test_radiographs_at_one_place_are_one_push_from_no_force_upwards():
    pushes = plan.placed([proposed("left", 5.0, 80.0), proposed("right", 8.0, 60.0), proposed("left", 5.0, 40.0)])
    assert {name: (one.side, one.level, one.force_n) for name, one in pushes.items()} == {
        "left-5": ("left", 5.0, 80.0),
        "right-8": ("right", 8.0, 60.0),
    }
    assert pushes["left-5"].frames == ((0.0, "unused"), (0.5, "training"), (1.0, "training"))
    for name, one in pushes.items():
        forces = tuple(share * one.force_n for share, _ in one.frames)
        record = PushRecord(
            id=name, side=one.side, level=one.level, d21_mm=400.0, d31_mm=200.0, frames="a.dcm", forces_n=forces,
            roles=tuple(role for _, role in one.frames),
        )  # fmt: skip
        assert record.forces_n[-1] == one.force_n


def person(seed, reached, promised):
    told = {name: {"reached": reached, "interval": 2.0, "open": False, "inside": True} for name in plan.NAMES}
    planned = {name: {**own, "interval": 2.0**0.5} for name, own in told.items()}
    planned["promised"] = dict.fromkeys(plan.NAMES, promised)
    return {"seed": seed, "paper": told, **dict.fromkeys(plan.ARMS[1:], planned)}


def test_promised_and_reached_widths_are_compared_over_people_of_whom_all_is_known():
    rows = [person(1, 2.0, 2.0), person(2, 4.0, 2.0), person(3, 8.0, 2.0), {"seed": 4, "failed": "no equilibrium"}]
    paper, following, *_ = plan.summarised(rows)
    assert (paper["people"], paper["failed"], paper["pushes"]) == (3, 1, "paper")
    beside = paper["tissue"].pop("narrower_than")
    assert paper["tissue"] == {"reached": 4.0, "interval": 2.0, "open": 0, "inside": 3}
    assert list(beside) == list(plan.ARMS[1:])
    assert beside["best three"] == {"people": 0, "share_of_width": 2.0}
    assert following["tissue"]["narrower_than"]["paper"] == {"people": 3, "share_of_width": 0.5}
    assert following["tissue"]["narrower_than"]["best three"] == {"people": 0, "share_of_width": 1.0}
    # Widths are logs of factors: 2, 4 and 8 are one, two and three times what was promised.
    assert following["tissue"]["promised"] == 2.0
    assert following["tissue"]["reached_over_promised_width"] == pytest.approx([1.2, 2.0, 2.8])
