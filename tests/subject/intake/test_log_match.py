"""A gauge's log beside frames: a known offset is found within its stated error, or said to be open."""

from __future__ import annotations

import re

import numpy as np
import pytest

from spinestiff.subject.intake.force_log import ForceLog
from spinestiff.subject.intake.log_match import given_offset, match_log, outside
from spinestiff.subject.intake.logged import Logged

PEAK_N = 58.0


def pushed(rng, noise=0.2, pull_back=True):
    """Nothing, a rise in 3 s, a hold, and back."""
    times = np.arange(0.0, 18.0, 0.02)
    forces = np.interp(times, [0.0, 5.0, 8.0, 12.0, 14.0], [0.0, 0.0, PEAK_N, PEAK_N, 0.0 if pull_back else PEAK_N])
    return ForceLog(times, np.abs(forces + noise * rng.standard_normal(len(times))))


def moved(log, times, noise, rng, bent=0.3):
    """A trunk that stiffens, seen with noise, in pixels."""
    share = log.at(times) / PEAK_N
    motion = 12.0 * share * (1.0 + bent * (1.0 - share)) + noise * rng.standard_normal(len(times))
    return motion - motion[0]


def test_known_offsets_lie_in_their_intervals():
    inside, determined = [], []
    rng = np.random.default_rng(3)
    for trial in range(40):
        log = pushed(rng)
        start = rng.uniform(2.0, 4.5)
        times = np.arange(28 + trial % 8) / 4.0
        found = match_log(log, times, moved(log, times + start, 0.15, rng))
        inside.append(found.low_s <= start <= found.high_s)
        determined.append(found.determined)
        assert (log.at(times + start) >= found.forces_low_n - 1.0).all()
        assert (log.at(times + start) <= found.forces_high_n + 1.0).all()
    assert np.mean(inside) >= 0.95
    assert np.mean(determined) >= 0.9


def test_a_known_offset_is_found_to_a_twentieth_of_a_second_where_little_disturbs():
    rng = np.random.default_rng(0)
    log = pushed(rng)
    times = np.arange(36) / 4.0
    found = match_log(log, times, moved(log, times + 3.1, 0.03, rng))
    assert found.determined and found.why == ""
    assert found.offset_s == pytest.approx(3.1, abs=0.05)
    assert found.high_s - found.low_s < 0.5
    assert found.explained > 0.99
    np.testing.assert_allclose(found.forces_n, log.at(times + 3.1), atol=1.5)


def test_a_trunk_that_creeps_by_a_tenth_within_a_second_leaves_the_true_offset_in_the_interval():
    rng = np.random.default_rng(8)
    log = pushed(rng)
    at_once = log.forces_n / PEAK_N
    late, step = np.zeros_like(at_once), log.step_s
    for i in range(1, len(late)):
        late[i] = late[i - 1] + step * (at_once[i] - late[i - 1])
    crept = 12.0 * (0.9 * at_once + 0.1 * late)
    times = np.arange(40) / 4.0
    for start in (2.0, 2.6, 3.3):
        motion = np.interp(times + start, log.times_s, crept) + 0.03 * rng.standard_normal(40)
        found = match_log(log, times, motion - motion[0])
        assert found.offset_s < start and found.low_s <= start <= found.high_s


def test_a_motion_that_turns_back_while_the_force_rises_is_none_of_a_push():
    rng = np.random.default_rng(9)
    log = pushed(rng, pull_back=False)
    times = np.arange(36) / 4.0
    share = log.at(times + 3.1) / PEAK_N
    found = match_log(log, times, 48.0 * share * (1.0 - share) + 0.03 * rng.standard_normal(36))
    assert not found.determined and "of the motion at best" in found.why


def test_a_motion_that_runs_the_other_way_is_matched_alike():
    rng = np.random.default_rng(1)
    log = pushed(rng)
    times = np.arange(36) / 4.0
    motion = moved(log, times + 3.1, 0.03, rng)
    one, other = match_log(log, times, motion), match_log(log, times, -motion)
    assert one.offset_s == pytest.approx(other.offset_s, abs=1e-9)


def test_a_release_and_a_rise_are_told_apart_or_both_left_open():
    """Frames of a rise alone fit the fall, too, seen the other way round."""
    rng = np.random.default_rng(2)
    times = np.arange(0.0, 20.0, 0.02)
    forces = np.interp(times, [0.0, 5.0, 7.0, 11.0, 13.0, 20.0], [0.0, 0.0, 50.0, 50.0, 0.0, 0.0])
    log = ForceLog(times, np.abs(forces + 0.2 * rng.standard_normal(len(times))))
    seen = np.arange(16) / 4.0
    motion = 0.2 * log.at(seen + 4.0) + 0.05 * rng.standard_normal(16)
    found = match_log(log, seen, motion - motion[0])
    assert not found.determined and "is possible, which leaves a frame's force open" in found.why
    assert re.search(r"open by ± \d+\.\d N, wanted ± \d+\.\d N or less$", found.why)
    assert found.low_s < 4.0 < 10.0 < found.high_s


def test_a_frame_of_which_the_offset_leaves_the_force_open_is_left_out_alone():
    """A frame of a second in which the force rises by 40 N a second, among others that lie on plateaus."""
    rng = np.random.default_rng(6)
    times = np.arange(0.0, 20.0, 0.02)
    log = ForceLog(times, np.interp(times, [0.0, 5.0, 6.0, 9.0, 9.4, 20.0], [0.0, 0.0, 40.0, 40.0, 60.0, 60.0]))
    seen = np.array([0.0, 1.0, 2.5, 3.4, 4.0, 5.0, 7.0, 8.0])
    found = match_log(log, seen, moved(log, seen + 3.0, 0.02, rng))
    assert found.determined and found.uncertain == (2,) and np.isnan(found.forces_n[2])
    assert found.forces_high_n[2] - found.forces_low_n[2] > 12.0 > 2.0 * found.open_n
    np.testing.assert_allclose(np.delete(found.forces_n, 2), [0, 0, 40, 40, 40, 60, 60])
    (words,) = Logged(log, seen, seen, found).untold
    assert re.match(r"the offset, from 2\.\d+ to 3\.\d+ s, leaves the force of frame 2 open by up to ± \d+ N$", words)


def test_a_flat_log_a_still_picture_and_few_frames_are_not_matched():
    rng = np.random.default_rng(4)
    times = np.arange(20) / 4.0
    flat = ForceLog(np.arange(0.0, 20.0, 0.1), np.full(200, 3.0) + 0.2 * rng.random(200))
    log = pushed(rng)
    motion = moved(log, times + 3.5, 0.05, rng)
    cases = {
        "the log's force changes by 0.2 N only": match_log(flat, times, motion),
        "pixels only": match_log(log, times, 0.02 * motion),
        "3 frames are too few, wanted 4 or more": match_log(log, times[:3], motion[:3]),
        "the log lasts 2.0 s, the frames 4.8 s": match_log(ForceLog([0.0, 2.0], [0.0, 50.0]), times, motion),
        "of the motion at best": match_log(log, times, 5.0 * rng.standard_normal(20)),
    }
    for why, found in cases.items():
        assert not found.determined and why in found.why, found.why


@pytest.mark.parametrize(("begins", "why"), [(3.8, "the match lies at an end of the log"), (6.5, "")])
def test_a_log_that_begins_after_the_frames_is_not_matched(begins, why):
    rng = np.random.default_rng(5)
    whole = pushed(rng, pull_back=False)
    late = ForceLog(whole.times_s[whole.times_s > begins], whole.forces_n[whole.times_s > begins])
    times = np.arange(36) / 4.0
    found = match_log(late, times, moved(whole, times + 3.0, 0.03, rng))
    assert not found.determined and why in found.why


def test_a_log_that_begins_with_the_first_frame_is_matched():
    rng = np.random.default_rng(6)
    whole = pushed(rng)
    cut = ForceLog(whole.times_s[whole.times_s >= 3.0] - 3.0, whole.forces_n[whole.times_s >= 3.0])
    times = np.arange(36) / 4.0
    found = match_log(cut, times, moved(whole, times + 3.0, 0.03, rng))
    assert found.determined and found.low_s <= 0.0 <= found.high_s


def test_a_given_offset_is_taken_as_it_is():
    rng = np.random.default_rng(7)
    log = pushed(rng)
    times = np.arange(20) / 4.0
    motion = moved(log, times + 4.0, 0.05, rng)
    right, wrong = given_offset(log, times, 4.0, motion), given_offset(log, times, 9.0, motion)
    assert right.given and right.determined
    np.testing.assert_array_equal(right.forces_n, log.at(times + 4.0))
    assert right.explained > 0.99 > 0.9 > wrong.explained
    few = given_offset(log, times[:3], 4.0, motion[:3])
    assert np.isnan(few.explained) and few.against == ""


def test_an_offset_is_held_against_the_motion():
    rng = np.random.default_rng(7)
    log, times = pushed(rng), np.arange(40) / 4.0
    motion = moved(log, times + 4.0, 0.05, rng)
    found = match_log(log, times, motion)
    assert found.determined
    assert given_offset(log, times, 4.0, motion, found).against == ""
    assert given_offset(log, times, 5.0, motion, found).against.startswith("the motion says 4.0")
    open_one = match_log(log, times[:3], motion[:3])
    assert not open_one.determined
    assert "% of the motion only" in given_offset(log, times, 8.0, motion, open_one).against


def test_how_far_frames_reach_beyond_a_log():
    log = ForceLog([1.0, 5.0], [0.0, 10.0])
    times = np.array([0.0, 2.0])
    assert [outside(log, times, offset) for offset in (1.0, 3.0, 0.5, 4.0)] == [0.0, 0.0, 0.5, 1.0]


def test_frames_beyond_a_cut_log_or_in_its_gap_have_no_force():
    rng = np.random.default_rng(7)
    whole, times = pushed(rng), np.arange(36) / 4.0
    motion = moved(whole, times + 3.0, 0.05, rng)

    def given(kept):
        log = ForceLog(whole.times_s[kept], whole.forces_n[kept])
        return given_offset(log, times, 3.0, motion).forces_n

    there = times + 3.0
    cut, holed = given(whole.times_s < 7.0), given(np.abs(whole.times_s - 6.0) > 0.5)
    np.testing.assert_array_equal(np.isnan(cut), there > 7.1)
    np.testing.assert_array_equal(np.isnan(holed), np.abs(there - 6.0) < 0.4)
    found = match_log(
        ForceLog(whole.times_s[whole.times_s < 11.9], whole.forces_n[whole.times_s < 11.9]), times, motion
    )
    assert np.isfinite(found.open_n)
