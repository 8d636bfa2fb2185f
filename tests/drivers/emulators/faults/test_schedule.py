import math

import numpy as np
import pytest

from gyrobench.drivers.emulators.faults.fault import Persistence, Timing
from gyrobench.drivers.emulators.faults.injector import Schedule


class Moment(Timing):
    persistence = Persistence.MOMENTARY


def schedule(start_s=0.0, seed=0, kind=Timing, **keys):
    return Schedule(kind(**keys), np.random.default_rng(seed), start_s)


def run(schedule, until_s):
    """All begins and ends up to a time, each at the moment that the schedule names."""
    events = []
    while schedule.next_s <= until_s:
        now_s = schedule.next_s
        if schedule.ends(now_s):
            events.append(("end", now_s))
        elif schedule.begins(now_s):
            events.append(("begin", now_s))
    return events


def test_one_moment_comes_once():
    assert run(schedule(kind=Moment, at_s=5.0), 1e9) == [("begin", 5.0)]


def test_a_fault_with_a_duration_ends_by_itself():
    assert run(schedule(at_s=5.0, for_s=3.0), 1e9) == [("begin", 5.0), ("end", 8.0)]


def test_a_fault_without_a_duration_stays():
    assert run(schedule(at_s=5.0), 1e9) == [("begin", 5.0)]


def test_random_times_have_their_mean_spacing_and_repeat_with_the_seed():
    events = run(schedule(kind=Moment, every_s=100.0), 1e6)
    assert len(events) == pytest.approx(1e4, abs=400)
    assert events == run(schedule(kind=Moment, every_s=100.0), 1e6)
    assert events != run(schedule(kind=Moment, every_s=100.0, seed=1), 1e6)
    gaps_s = np.diff([time_s for _, time_s in events])
    assert gaps_s.std() == pytest.approx(100.0, rel=0.1)


def test_random_times_begin_after_from_s_and_stop_after_so_many():
    events = run(schedule(kind=Moment, every_s=10.0, from_s=500.0, times=3), 1e9)
    assert len(events) == 3
    assert events[0][1] > 500.0


def test_the_next_one_waits_for_the_end_of_the_last():
    events = run(schedule(every_s=1.0, for_s=60.0), 1e4)
    assert [event for event, _ in events[:4]] == ["begin", "end", "begin", "end"]
    times_s = [time_s for _, time_s in events]
    assert times_s == sorted(times_s)


def test_a_phase_counts_from_its_nth_beginning():
    timing = schedule(kind=Moment, during="turn", nth=2, after_s=1.5)
    for now_s, in_phase in ((10.0, True), (20.0, False), (30.0, True)):
        timing.observe(in_phase, now_s)
    assert run(timing, 1e9) == [("begin", 31.5)]
    timing.observe(False, 40.0)
    timing.observe(True, 50.0)
    assert timing.next_s == math.inf


def test_a_phase_may_count_several_times():
    timing = schedule(kind=Moment, during="turn", times=2)
    begun = []
    for now_s, in_phase in ((10.0, True), (20.0, False), (30.0, True), (40.0, False), (50.0, True)):
        timing.observe(in_phase, now_s)
        begun += run(timing, now_s)
    assert begun == [("begin", 10.0), ("begin", 30.0)]


def test_a_phase_that_ends_too_early_has_no_fault():
    timing = schedule(kind=Moment, during="turn", after_s=5.0, times=2)
    timing.observe(True, 10.0)
    timing.observe(False, 12.0)
    assert timing.next_s == math.inf
    timing.observe(True, 20.0)
    assert timing.next_s == 25.0


def test_a_fault_that_began_in_a_phase_outlives_it():
    timing = schedule(during="turn", for_s=30.0)
    timing.observe(True, 10.0)
    assert timing.begins(10.0)
    timing.observe(False, 12.0)
    assert timing.next_s == 40.0


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"at_s": 50.0, "for_s": 10.0}, []),
        ({"at_s": 95.0, "for_s": 10.0}, [("begin", 95.0), ("end", 105.0)]),
        ({"at_s": 50.0}, [("begin", 50.0)]),
        ({"at_s": 100.0, "for_s": 1.0}, [("begin", 100.0), ("end", 101.0)]),
    ],
)
def test_a_restarted_bench_has_what_still_lasts_and_not_what_is_over(keys, expected):
    assert run(schedule(start_s=100.0, **keys), 1e9) == expected


def test_a_momentary_fault_does_not_repeat_on_a_restarted_bench():
    assert run(schedule(start_s=100.0, kind=Moment, at_s=50.0), 1e9) == []
