"""benchmarks/discrepancy_pairs.py and discrepancy.py: laws of the variants, true ratios, and what is learnt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from programs import benchmark
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import EquilibriumError
from spinestiff.estimation.discrepancy import MIRROR
from spinestiff.mechanics.contact import OneSidedProblem
from spinestiff.mechanics.supports import SupportKind, three_point_supports

pairs = benchmark("discrepancy_pairs")
discrepancy = benchmark("discrepancy")


@pytest.fixture(scope="module")
def bench():
    return pairs.Bench(template_torso(157.0))


def test_the_wall_of_a_one_sided_bench_does_not_pull(bench) -> None:
    ratios = pairs.stiffness_ratios({"lateral_bending": 0.3, "tissue": 0.3})
    load = bench.load("right", 8.0, 30.0)
    supports = three_point_supports(bench.torso, "right", pairs.PELVIS)
    alone = OneSidedProblem(bench.torso, supports).solve(load, ratios).require()
    wall = np.array([r.force[2] for r in alone.reactions if r.kind is SupportKind.WALL])
    assert wall.min() >= -1e-6 and 0 < (wall > 0.0).sum() < len(wall)
    found = pairs.Bench(bench.torso, one_sided=True).solve("right", load, ratios)
    np.testing.assert_allclose(found.bone_positions, alone.state.bone_positions, atol=1e-6)


def test_the_standard_laws_true_ratios_are_those_it_is_solved_with(bench) -> None:
    ratios = pairs.stiffness_ratios({"lateral_bending": 0.3, "tissue": 0.7})
    np.testing.assert_allclose(bench.true_ratios(ratios), ratios.values, rtol=1e-12)


def test_a_variants_ratios_are_sought_until_the_true_ones_are_the_models(bench) -> None:
    wanted = pairs.stiffness_ratios({"lateral_bending": 0.3, "tissue": 0.7})
    stiffer, _ = pairs.stiffening(bench.torso, np.random.default_rng(1))
    found, left = pairs.equal_ratios(stiffer, wanted)
    assert found.values[0] != pytest.approx(0.3, rel=0.1)
    np.testing.assert_allclose(stiffer.true_ratios(found), wanted.values * np.exp(left), rtol=1e-6)
    assert np.abs(left).max() < pairs.EQUAL


class Yielding:
    """In place of a bench: its vertebrae turn by ``degrees`` a newton, and it carries no more than ``most`` newtons."""

    def __init__(self, degrees: float, most: float = np.inf) -> None:
        self.degrees, self.most = degrees, most

    def load(self, side, level, force):
        return force

    def solve(self, side, load, ratios):
        if load > self.most:
            raise EquilibriumError("gives way")
        return load

    def motion(self, state):
        return np.outer(np.linspace(0.0, 1.0, 17), [0.0, 0.0, np.deg2rad(self.degrees * state)])


def test_a_push_has_as_much_force_as_the_torso_carries() -> None:
    assert pairs.carried(Yielding(0.5), "left", 8.0, 60.0, None) == (60.0, 60.0)
    force, state = pairs.carried(Yielding(1.0), "left", 8.0, 60.0, None)
    assert force == state and 40.0 < force <= 45.0
    assert 20.0 < pairs.carried(Yielding(0.1, most=40.0), "left", 8.0, 60.0, None)[0] <= 40.0
    with pytest.raises(EquilibriumError, match="more than 45 degrees under any push at rib 8"):
        pairs.carried(Yielding(4.0), "left", 8.0, 60.0, None)


def test_everybody_and_every_kind_has_a_turn() -> None:
    made = list(pairs.tasks(0, 24))
    assert [number for number, mesh, _ in made if mesh == "coarse"] == list(range(24))
    count = {kind: sum((kind, 0) in kinds for *_, kinds in made) for kind in (*pairs.KINDS, *pairs.FINE_EVERY)}
    assert count["body"] == count["other mesh"] == 24 and sum(("body", 1) in kinds for *_, kinds in made) == 24
    assert count["geometry"] == count["finer mesh"] == count["one-sided wall"] == 6
    assert count["other fine mesh"] == 8 and count["fine to limit"] == 3


def test_slopes_are_derivatives_of_motions(bench) -> None:
    ratios = pairs.stiffness_ratios({"lateral_bending": 0.3, "tissue": 0.7})
    load = bench.load("left", 7.0, 30.0)
    state, slope = bench.linearised("left", load, ratios, None)
    for i in range(2):
        ends = [
            bench.motion(bench.solve("left", load, ratios.with_values(ratios.values * np.exp(h * np.eye(2)[i])), state))
            for h in (1e-3, -1e-3)
        ]
        np.testing.assert_allclose(slope[..., i], (ends[0] - ends[1]) / 2e-3, atol=1e-5 * np.abs(slope[..., i]).max())


# What is learnt, from pairs whose differences are drawn


def _pair(kind: str, number: int, scale: float = 0.03):
    random = np.random.default_rng([number, *kind.encode()])
    frames = [{"use": "grid", "side": side, "level": level} for side, level in pairs.GRID]
    frames += [{"use": "off grid", "side": "left", "level": 6.2}, {**frames[4], "use": "half"}]
    count = len(frames)
    model = random.normal(0.0, 5.0, (count, 17, 3))
    model[7] = 0.5 * model[4]
    difference = scale * random.normal(0.0, 5.0, (count, 17, 3))
    difference[7] = 0.5 * difference[4]
    slopes, explicit = random.normal(0.0, 2.0, (count, 17, 3, 2)), np.zeros((count, 17, 3, 4))
    return discrepancy.Pair(kind, number, tuple(frames), model, difference, slopes, explicit)


@pytest.fixture(scope="module")
def drawn():
    return [_pair(kind, number) for kind in (*discrepancy.EXPECTED["coarse"], "volume") for number in range(8)]


def test_a_kinds_moment_is_that_of_its_pairs_and_their_mirror_images(drawn) -> None:
    own = [pair for pair in drawn if pair.kind == "layers"]
    learnt = discrepancy.learn_kind(own)
    wanted = np.mean([np.mean(pair.relative(pair.grid) ** 2) for pair in own])
    assert np.mean(np.diag(learnt.moment)) == pytest.approx(wanted, rel=1e-9)
    sign = np.tile(MIRROR, (2, 3, 17, 1))
    there = sign.ravel()[:, None] * learnt.moment * sign.ravel()
    swapped = there.reshape(2, 153, 2, 153)[::-1, :, ::-1].reshape(306, 306)
    np.testing.assert_allclose(swapped, learnt.moment, atol=1e-12)


def test_frames_in_proportion_have_no_own_share(drawn) -> None:
    assert discrepancy.own_share(drawn) == pytest.approx(0.0, abs=1e-12)
    pair = drawn[0]
    other = pair.difference.copy()
    other[7] = -other[7]
    turned = discrepancy.Pair(pair.kind, 0, pair.frames, pair.model, other, pair.slopes, pair.explicit)
    assert discrepancy.own_share([turned]) == pytest.approx(2.0)


def test_a_kind_like_the_others_is_covered_and_one_far_larger_is_not(drawn) -> None:
    found = discrepancy.coverages(discrepancy.leave_one_out(drawn, 1.0, 0.3))
    assert found["pooled"]["both"] > 0.9
    others = [pair for pair in drawn if pair.kind != "stiffening"]
    larger = [*others, *(_pair("stiffening", number, scale=0.4) for number in range(8))]
    found = discrepancy.coverages(discrepancy.leave_one_out(larger, 1.0, 0.3))
    assert found["by_kind"]["stiffening"]["both"] < 0.5


def test_what_an_estimate_solves_for_is_covered_though_no_other_kind_has_it(drawn) -> None:
    far = [_pair("rib joints", number, scale=0.4) for number in range(8)]
    along = [replace(pair, explicit=pair.difference[..., None]) for pair in far]
    bare, solved = (
        discrepancy.coverages(discrepancy.leave_one_out([*drawn, *own], 1.0, 0.3))["by_kind"]["rib joints"]["both"]
        for own in (far, along)
    )
    assert bare < 0.5 and solved > 0.9


def test_explained_modes_are_of_what_an_estimate_expects(drawn) -> None:
    data = discrepancy.learn(drawn, 1.0, 0.3)
    found = discrepancy.explained(data, "coarse")
    shares = discrepancy.EXPECTED["coarse"]
    assert set(found["left_out_kind"]) == set(found["parts"]) == set(shares)
    traces = {kind: share * np.trace(data.kinds[kind].moment) for kind, share in shares.items()}
    taken = data.combined(shares).modes.reshape(discrepancy.MODES, -1)
    assert found["by_modes"][3] == pytest.approx(np.sum(taken[:4] ** 2) / sum(traces.values()), abs=1e-3)
    assert found["parts"]["body"] == pytest.approx(traces["body"] / sum(traces.values()), abs=1e-4)


def test_the_wall_is_tested_and_not_pooled(drawn) -> None:
    walls = [_pair("one-sided wall", number, scale=0.9) for number in range(4)]
    found = discrepancy.coverages(discrepancy.leave_one_out([*drawn, *walls], 1.0, 0.3))
    assert found["by_kind"]["one-sided wall"]["both"] < 0.5 < found["pooled"]["both"]
    assert found["pooled"]["estimates"] > found["pooled_without_unknowns"]["estimates"] > 0
    of_walls = len(walls) * len(walls[0].acquisitions())
    assert sum(one["estimates"] for one in found["by_kind"].values()) - of_walls == found["pooled"]["estimates"]


def test_a_truth_that_left_the_branch_is_told(drawn) -> None:
    assert not any(pair.buckled for pair in drawn)
    assert _pair("one-sided wall", 1, scale=1.5).buckled


def test_pairs_are_read_up_to_the_line_that_was_cut(tmp_path) -> None:
    path = tmp_path / "pairs.jsonl"
    path.write_text('{"kind": "layers", "subject": 0}\n{"kind": "vol', encoding="utf-8")
    assert pairs.read(path) == [{"kind": "layers", "subject": 0}]


def test_each_subject_and_kind_is_drawn_from_its_own_seed() -> None:
    assert pairs.subject_of(3) == pairs.subject_of(3) != pairs.subject_of(4)
    draws = (("layers", 0), ("layers", 0), ("layers", 1), ("volume", 0))
    first, again, *others = (pairs.subject_of(3).random(*draw).random() for draw in draws)
    assert first == again and first not in others
