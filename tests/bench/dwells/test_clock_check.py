"""The rate of the INS's clock against the arrival of its frames."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from gyrobench.bench.dwells.clock_check import clock_fault, increments_fault
from gyrobench.bench.dwells.measure_dwell import measure_dwell
from gyrobench.bench.foundations.text import flag_text
from gyrobench.bench.station.station import Station
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc
from gyrobench.drivers.ins.navigation_data import decode_increments
from gyrobench.drivers.ins.signal_map import SignalMap
from tests.adversarial.frames import dwell_frames
from tests.adversarial.harness import STATION, Case, any_unit, dwell_angles, measured_dwells, setup_of
from tests.adversarial.strapdown import Place, Schedule, simulate

PERIOD_S, EPOCHS = 0.1, 12300
NUMBER = np.arange(EPOCHS)
ONE_SEGMENT = np.zeros(EPOCHS, np.int64)
CODEC = DbcCodec(load_dbc(Station(STATION).dbc_path))
_MAP = yaml.safe_load(STATION.read_text())["ins"]["signals"]
TIMED = SignalMap.model_validate(_MAP)
COUNTED = SignalMap.model_validate({**_MAP, "time_s": None, "time_ns": None})
UNCOUNTED = SignalMap.model_validate({**_MAP, "time_s": None, "time_ns": None, "epoch_counter": None})


def polled(random, mean_s=0.1):
    """Arrival stamped by polls of irregular distance."""
    polls_s = np.cumsum(random.uniform(0.5, 1.5, round(1.2 * EPOCHS * PERIOD_S / mean_s)) * mean_s)
    return polls_s[np.searchsorted(polls_s, PERIOD_S * NUMBER)]


def late_bursts(random):
    """Three stretches of 20 s whose frames come together at their end."""
    arrival_s = PERIOD_S * NUMBER
    for begin in random.integers(0, EPOCHS - 200, 3):
        arrival_s[begin : begin + 200] = arrival_s[begin + 200]
    return arrival_s


def step_of_the_clock(random):
    return PERIOD_S * NUMBER + random.choice([-3600.0, -3.0, 1.0, 10.0]) * (random.integers(EPOCHS) < NUMBER)


SOUND = {
    "200 ppm apart": lambda random: PERIOD_S * NUMBER * (1.0 + random.choice([-2e-4, 2e-4])),
    "jitter of 5 ms": lambda random: PERIOD_S * NUMBER + random.exponential(0.005, EPOCHS),
    "jitter of 1 s": lambda random: PERIOD_S * NUMBER + random.exponential(1.0, EPOCHS),
    "polled": polled,
    "polled slowly": lambda random: polled(random, 0.5),
    "polled at nearly the rate of epochs": lambda _: np.ceil(NUMBER / 1.0004) * 1.0004 * PERIOD_S,
    "late bursts": late_bursts,
    "step of the clock": step_of_the_clock,
    "no times of arrival": lambda _: np.zeros(EPOCHS),
    "arrival not a number": lambda _: np.full(EPOCHS, np.nan),
    "one stamp for a minute": lambda _: np.ceil(NUMBER / 600.0) * 60.0,
}


@pytest.mark.parametrize("kind", SOUND)
@pytest.mark.parametrize("epochs", [EPOCHS, 1200])
def test_sound_clocks_are_not_flagged_however_frames_arrive(kind, epochs):
    for seed in range(20):
        random = np.random.default_rng(seed)
        arrival_s = 1.7e9 + SOUND[kind](random)[:epochs]
        time_s = PERIOD_S * NUMBER[:epochs]
        there = random.random(epochs) > 0.01
        there[epochs // 3 : epochs // 3 + epochs // 10] = False
        for signals in (TIMED, COUNTED, UNCOUNTED):
            assert clock_fault(time_s[there], arrival_s[there], ONE_SEGMENT[:epochs][there], signals) == ""


@pytest.mark.parametrize("error", [-0.5, -0.04, -0.001, 0.001, 0.02, 1.0])
@pytest.mark.parametrize("kind", ["jitter of 5 ms", "polled", "late bursts"])
def test_a_wrong_epoch_period_is_named_with_the_one_that_fits(error, kind):
    arrival_s = 1.7e9 + SOUND[kind](np.random.default_rng(1))
    declared_s = PERIOD_S * (1.0 + error)
    signals = COUNTED.model_copy(update={"epoch_period_s": declared_s})
    fault = clock_fault(declared_s * NUMBER, arrival_s, ONE_SEGMENT, signals)
    assert "an epoch every 0.1 s" in fault
    assert f"ins.signals.epoch_period_s is {declared_s:g} s" in fault


@pytest.mark.parametrize("first", [2000, 9000])
def test_time_stamps_that_went_back_and_are_zero_in_the_log_say_nothing_about_the_rate(first):
    arrival_s = np.where(first > NUMBER, PERIOD_S * NUMBER, 0.0)  # a counter of 32 bit that overflows
    assert clock_fault(PERIOD_S * NUMBER, arrival_s, ONE_SEGMENT, TIMED) == ""


def test_a_wrong_scale_of_the_time_is_named_with_the_factor_that_fits():
    arrival_s = 1.7e9 + PERIOD_S * NUMBER
    fault = clock_fault(1e3 * PERIOD_S * NUMBER, arrival_s, ONE_SEGMENT, TIMED)
    assert "runs at 1000 times the rate of the bench's clock" in fault
    assert "scale and unit of ins.signals.time_s: 0.001 times the present scale fits" in fault


@pytest.mark.parametrize("period_s", [0.096, 0.1, 0.104])
def test_a_dwell_with_a_wrong_epoch_period_gives_no_bias(period_s):
    station = {
        "ins.signals.time_s": None,
        "ins.signals.time_ns": None,
        "ins.signals.epoch_period_s": period_s,
    }
    random = np.random.default_rng(3)
    (dwell,) = measured_dwells(Case(any_unit(random), Place(), station=station, positions=("z_up",)), random)
    if period_s == 0.1:
        assert dwell.flags == ()
        assert dwell.setup_fault == ""
    else:
        assert dwell.estimate is None
        assert "Correct epoch_period_s" in dwell.setup_fault


def time_sent_every_20_s(random, passed):
    """What a dwell says of the clock of an INS whose time is ``passed`` of the time since the start."""
    case = Case(any_unit(random), Place(), positions=("z_up",))
    angles = dwell_angles(setup_of(case), "z_up")
    output = simulate(case.unit, case.place, case.schedule, angles, random)
    marks, frames = dwell_frames(output, "z_up", angles, 1, random)
    sent = np.flatnonzero(frames.arbitration_id == 1)
    frames.rows["id"][sent[np.arange(len(sent)) % 20 > 0]] = 0x7FF
    seconds = np.round(1000.0 * passed(np.arange(len(sent)))).astype(np.int64)
    words = np.stack([seconds // 1000, seconds % 1000 * 1_000_000], axis=-1).astype("<u4")
    frames.rows["data"][sent] = words.view(np.uint8).reshape(len(sent), 8)
    return measure_dwell(marks, frames, setup_of(case))


@pytest.mark.parametrize("period_s", [0.05, 0.2])
def test_an_epoch_period_that_contradicts_the_time_of_the_ins_is_named(period_s):
    random, station = np.random.default_rng(3), {"ins.signals.epoch_period_s": period_s}
    case = Case(any_unit(random), Place(), Schedule(window_s=90.0), station, positions=("z_up",))
    (dwell,) = measured_dwells(case, random)
    assert f"ins.signals.epoch_period_s ({period_s:g} s) is not the period" in dwell.setup_fault


@pytest.mark.parametrize("rate", [0.94, 1.06])
def test_a_time_that_runs_at_another_rate_is_no_reset_of_the_clock(rate):
    dwell = time_sent_every_20_s(np.random.default_rng(5), lambda second: rate * second)
    assert f"the time of the INS runs at {rate} times the rate of the bench's clock" in dwell.setup_fault
    assert f"{1.0 / rate:.4g} times the present scale fits" in dwell.setup_fault


def test_a_clock_that_is_reset_again_and_again_is_not_taken_for_one_at_another_rate():
    for seed in range(5):
        random = np.random.default_rng(seed)
        jump_s = random.uniform(-30.0, 30.0, 100)[NUMBER[:3000] // 60]
        dwell = time_sent_every_20_s(random, lambda second, jump_s=jump_s: 9000.0 + second + jump_s[second])
        assert dwell.setup_fault == ""
        assert "the clock of the INS was reset" in flag_text(dwell.flags)


SAMPLE_S, SAMPLES = 0.01, 30000
ARRIVALS = {
    "200 ppm apart": lambda _, sent_s: 1.0002 * sent_s,
    "jitter of 1 ms": lambda random, sent_s: sent_s + random.exponential(0.001, SAMPLES),
    "jitter of 20 ms": lambda random, sent_s: sent_s + random.exponential(0.02, SAMPLES),
    "polled": lambda _, sent_s: np.ceil(sent_s / 0.1) * 0.1,
    "late by 2 s at times": lambda _, sent_s: np.where(
        sent_s % 60.0 < 2.0, sent_s // 60.0 * 60.0 + 2.0, sent_s
    ),
}
LOST = {
    "no sample": lambda _: np.ones(SAMPLES, np.bool_),
    "one sample in 100": lambda random: random.random(SAMPLES) > 0.01,
    "12 samples of 1000": lambda _: np.arange(SAMPLES) % 1000 > 11,
    "3 s five times": lambda _: np.arange(SAMPLES) % 6000 > 300,
}


def period_fault(declared_s, how, lost, has_counter, seed):
    """What the samples of five minutes say of the declared period."""
    random = np.random.default_rng(seed)
    arrival_s = 1.7e9 + np.maximum.accumulate(ARRIVALS[how](random, SAMPLE_S * np.arange(SAMPLES)))
    there = LOST[lost](random)
    words = (np.arange(SAMPLES, dtype="<u8") % 16 << 60)[there]
    stamps_s = arrival_s[there]
    frames = FrameBlock.from_columns(
        np.repeat(stamps_s, 2),
        np.tile([8, 9], len(stamps_s)),
        np.full(2 * len(stamps_s), 8),
        np.repeat(words, 2).view(np.uint8).reshape(-1, 8),
    )
    counter = {} if has_counter else {"counter": None}
    changed = {"increments": _MAP["increments"] | {"period_s": declared_s} | counter}
    increments = decode_increments(frames, SignalMap.model_validate(_MAP | changed), CODEC)
    return increments_fault(increments.sent, frames.timestamp_s[increments.row], declared_s)


@pytest.mark.parametrize("how", ARRIVALS)
@pytest.mark.parametrize("lost", LOST)
def test_increments_at_their_period_are_not_flagged_however_they_arrive(how, lost):
    for seed, has_counter in enumerate([True, False] * 2):
        assert period_fault(SAMPLE_S, how, lost, has_counter, seed) == ""


@pytest.mark.parametrize("declared_s", [0.005, 0.0098, 0.0102, 0.02, 0.1])
@pytest.mark.parametrize("how", ["200 ppm apart", "jitter of 1 ms", "late by 2 s at times"])
@pytest.mark.parametrize("has_counter", [True, False])
def test_a_wrong_period_of_the_increments_is_named_with_the_one_that_fits(declared_s, how, has_counter):
    fault = period_fault(declared_s, how, "3 s five times", has_counter, 1)
    assert "the INS sends increments every 0.01 s" in fault
    assert f"ins.signals.increments.period_s is {declared_s:g} s. Correct period_s" in fault
