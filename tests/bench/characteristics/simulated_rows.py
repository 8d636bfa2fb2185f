"""Dwell rows of simulated gyros: a lag, a follower with play and exponentials stepped in time."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.characteristics.results import Coefficient
from gyrobench.bench.foundations.arrays import FloatArray

DWELL_S = 130.0


def row(
    number: int, run: str, start_s: float, since_s: float, bias: FloatArray, sigma: float,
    celsius: float = 30.0, rate_c_per_h: float = 0.0, position: str = "z_up",
) -> DwellRow:  # fmt: skip
    """A dwell whose gyros have the same temperature."""
    return DwellRow(
        unit="1",
        run=run,
        dwell=number,
        cycle=1,
        position=position,
        start_s=start_s,
        end_s=start_s + DWELL_S,
        since_power_on_s=since_s,
        gyro_c=(celsius,) * 3,
        gyro_rate_c_per_h=(rate_c_per_h,) * 3,
        bias_dph=tuple(bias.tolist()),
        sigma_dph=(sigma,) * 3,
    )


def power_cycles(random: np.random.Generator, count: int, scatter_dph: float, sigma: float) -> list[DwellRow]:
    """One dwell in each of some power cycles."""
    biases = 0.01 + random.normal(0.0, scatter_dph, (count, 3)) + random.normal(0.0, sigma, (count, 3))
    return [row(i + 1, f"r{i}", 1e4 * i, 100.0, bias, sigma) for i, bias in enumerate(biases)]


def cold_start(
    random: np.random.Generator, amplitude_dph: float, time_constant_s: float, sigma: float = 0.0015
) -> list[DwellRow]:
    """Four hours of dwells after one power-on."""
    rows = []
    for number, since_s in enumerate(np.arange(60.0, 14400.0, 240.0), start=1):
        moments = np.linspace(since_s, since_s + DWELL_S, 40)
        bias = 0.01 + amplitude_dph * np.exp(-moments / time_constant_s).mean()
        rows.append(row(number, "r", since_s, since_s, bias + random.normal(0.0, sigma, 3), sigma))
    return rows


def temperature_cycles(play_c: float) -> Iterator[tuple[float, float, FloatArray]]:
    """Begin, mean temperature and (rate in K/min, lead of the follower in K) of dwells over three cycles.

    The gyro follows the air with a lag of 200 s, and 9 K above it.
    """
    air_c = gyro_c = 23.0
    follower_c, time_s = gyro_c, 0.0
    legs = [(60, 5), (20, 10), (-20, 5), (20, 10), (60, 10), (20, 5), (-20, 10), (20, 5), (60, 5), (20, 5)]

    def moved(duration_s: float, target_c: float, ramp_c_per_min: float) -> FloatArray:
        nonlocal air_c, gyro_c, follower_c, time_s
        course = []
        for _ in range(round(duration_s / 10.0)):
            air_c += float(np.clip(target_c - air_c, -ramp_c_per_min / 6.0, ramp_c_per_min / 6.0))
            before_c, gyro_c = gyro_c, gyro_c + (air_c + 9.0 - gyro_c) * 0.05
            follower_c = min(max(follower_c, gyro_c - play_c), gyro_c + play_c)
            time_s += 10.0
            course.append((gyro_c, 6.0 * (gyro_c - before_c), follower_c - gyro_c))
        return np.array(course)

    for target_c, ramp_c_per_min in legs:
        for dwells, soak_s in ((3, 480.0), (4, 0.0)):
            for _ in range(dwells):
                moved(60.0, target_c, ramp_c_per_min)
                mean = moved(DWELL_S, target_c, ramp_c_per_min).mean(axis=0)
                yield time_s - DWELL_S, float(mean[0]), mean[1:]
            moved(soak_s, target_c, ramp_c_per_min)


def over_temperature(
    random: np.random.Generator, bias_dph: Callable[[float, float, float], float], play_c: float, sigma: float
) -> list[DwellRow]:
    """Dwells with ``bias_dph`` of temperature, rate in K/min and lead in units of the play."""
    rows = []
    for number, (start_s, celsius, (rate, lead)) in enumerate(temperature_cycles(play_c), start=1):
        bias = bias_dph(celsius, rate, lead / play_c) + random.normal(0.0, sigma, 3)
        position = ("z_up", "x_up")[number % 2]
        rows.append(row(number, "r", start_s, start_s, bias, sigma, celsius, 60.0 * rate, position))
    return rows


def after_soaks(
    random: np.random.Generator, hysteresis_dph: float, play_c: float, sigma: float
) -> list[DwellRow]:
    """Dwells after soaks alone, four times at 60, 25, -10 and 25 degC; before the first the unit was heated.

    The gyro follows the air with a lag of 600 s.
    """
    air_c = gyro_c = follower_c = 25.0
    time_s, rows = 0.0, []
    for target_c in (60.0, 25.0, -10.0, 25.0) * 4:
        ramp_and_soak = round((60.0 * abs(target_c - air_c) + 3600.0) / 10.0)
        for dwell_steps in (0, 13, 13, 13):
            course = []
            before_c = gyro_c
            for _ in range(dwell_steps or ramp_and_soak):
                air_c += float(np.clip(target_c - air_c, -1.0 / 6.0, 1.0 / 6.0))
                gyro_c += (air_c - gyro_c) / 60.0
                follower_c = min(max(follower_c, gyro_c - play_c), gyro_c + play_c)
                time_s += 10.0
                course.append((gyro_c, (follower_c - gyro_c) / play_c))
            if dwell_steps:
                celsius, lead = np.mean(course, axis=0).tolist()
                bias = 0.01 + 2e-4 * (celsius - 25.0) + 0.5 * hysteresis_dph * lead
                rate_c_per_h, start_s = (gyro_c - before_c) / DWELL_S * 3600.0, time_s - DWELL_S
                number, position = len(rows) + 1, ("z_up", "x_up")[len(rows) % 2]
                measured = bias + random.normal(0.0, sigma, 3)
                rows.append(
                    row(number, "r", start_s, start_s, measured, sigma, celsius, rate_c_per_h, position)
                )
    return rows


def within_a_range(
    random: np.random.Generator,
    hysteresis_dph: float,
    play_c: float,
    sigma: float,
    low_c: float,
    high_c: float,
) -> list[DwellRow]:
    """Dwells every 7 min where the gyro is within a range, over four cycles from -20 to 60 degC.

    Ramps of 1 and 2 K/min, an hour at each end; the gyro follows the air with a lag of 600 s.
    """
    air_c = gyro_c = follower_c = 20.0
    time_s, due_s, rows = 0.0, 0.0, []
    course: list[tuple[float, float, float]] = []
    for target_c, ramp_c_per_min in ((60.0, 1.0), (-20.0, 1.0), (60.0, 2.0), (-20.0, 2.0)) * 2:
        for _ in range(round((60.0 * abs(target_c - air_c) / ramp_c_per_min + 3600.0) / 10.0)):
            air_c += float(np.clip(target_c - air_c, -ramp_c_per_min / 6.0, ramp_c_per_min / 6.0))
            before_c, gyro_c = gyro_c, gyro_c + (air_c - gyro_c) / 60.0
            follower_c = min(max(follower_c, gyro_c - play_c), gyro_c + play_c)
            time_s += 10.0
            if course or (time_s >= due_s and low_c <= gyro_c <= high_c):
                course.append((gyro_c, 6.0 * (gyro_c - before_c), (follower_c - gyro_c) / play_c))
            if len(course) == round(DWELL_S / 10.0):
                celsius, rate, lead = np.mean(course, axis=0).tolist()
                bias = 0.01 + 2e-4 * (celsius - 25.0) + 5e-4 * rate + 0.5 * hysteresis_dph * lead
                measured = bias + random.normal(0.0, sigma, 3)
                number, position = len(rows) + 1, ("z_up", "x_up")[len(rows) % 2]
                start_s = time_s - DWELL_S
                rows.append(
                    row(number, "r", start_s, start_s, measured, sigma, celsius, 60.0 * rate, position)
                )
                course, due_s = [], time_s + 300.0
    return rows


def holds(found: Coefficient, truth: float) -> bool:
    """Whether the interval holds the truth."""
    return (found.low is None or found.low <= truth) and (found.high is None or truth <= found.high)
