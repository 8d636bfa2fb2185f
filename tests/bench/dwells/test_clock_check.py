"""The rate of the INS's clock against the arrival of its frames."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from gyrobench.bench.dwells.clock_check import clock_fault
from gyrobench.drivers.ins.signal_map import SignalMap
from tests.adversarial.harness import STATION, Case, any_unit, measured_dwells
from tests.adversarial.strapdown import Place

PERIOD_S, EPOCHS = 0.1, 12300
NUMBER = np.arange(EPOCHS)
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
            assert clock_fault(time_s[there], arrival_s[there], signals) == ""


@pytest.mark.parametrize("error", [-0.5, -0.04, -0.001, 0.001, 0.02, 1.0])
@pytest.mark.parametrize("kind", ["jitter of 5 ms", "polled", "late bursts"])
def test_a_wrong_epoch_period_is_named_with_the_one_that_fits(error, kind):
    arrival_s = 1.7e9 + SOUND[kind](np.random.default_rng(1))
    declared_s = PERIOD_S * (1.0 + error)
    signals = COUNTED.model_copy(update={"epoch_period_s": declared_s})
    fault = clock_fault(declared_s * NUMBER, arrival_s, signals)
    assert "an epoch every 0.1 s" in fault
    assert f"ins.signals.epoch_period_s is {declared_s:g} s" in fault


def test_a_wrong_scale_of_the_time_is_named_with_the_factor_that_fits():
    arrival_s = 1.7e9 + PERIOD_S * NUMBER
    fault = clock_fault(1e3 * PERIOD_S * NUMBER, arrival_s, TIMED)
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
