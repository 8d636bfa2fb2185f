"""Searches of made-up campaigns, one for each verdict; each is made once."""

from dataclasses import replace
from functools import cache

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.laws import (
    BIAS_JUMP,
    G_SENSITIVITY,
    TEMPERATURE_RATE,
    THERMAL_GRADIENT,
    TIME_DRIFT,
)
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.navigation.positions import POSITIONS

SIGMA_DPH = 0.002
DWELLS_A_CYCLE = 48
#: deg/h for each K/h.
SENSITIVITY = np.array([0.0010, -0.0008, 0.0])
EFFECTS = [BIAS_JUMP, G_SENSITIVITY, TEMPERATURE_RATE, THERMAL_GRADIENT, TIME_DRIFT]
TWIN = replace(TEMPERATURE_RATE, name="twin", experiment="separate the twins")


def made_up_rows(sensitivity=SENSITIVITY, unknown_dph=0.0, scatter=1.0, boards=True, cycles=3, runs=1):
    """Dwells of half an hour up and down in temperature, whose bias follows the temperature's rate.

    Parameters
    ----------
    sensitivity : array_like, shape (3,)
        deg/h for each K/h.
    unknown_dph : float
        Amplitude of a bias that oscillates with a period of two hours.
    scatter : float
        Scatter of the biases over their stated uncertainties.
    boards : bool
        Whether the electronics have sensors.
    """
    random = np.random.default_rng(7)
    rows = []
    for number in range(cycles * DWELLS_A_CYCLE):
        cycle, place = divmod(number, DWELLS_A_CYCLE)
        start_s = 1800.0 * number
        phase = 2.0 * np.pi * place / DWELLS_A_CYCLE
        gyro_c = 25.0 + 30.0 * np.sin(phase) + 6.0 * np.sin(3.0 * phase) + np.array([0.0, 0.5, 1.0])
        slope = 2.0 * np.pi / (DWELLS_A_CYCLE * 0.5) * (30.0 * np.cos(phase) + 18.0 * np.cos(3.0 * phase))
        swing = unknown_dph * np.sin(2.0 * np.pi * (start_s + 900.0) / 7200.0 + 0.4)
        noise = scatter * SIGMA_DPH * random.standard_normal(3)
        bias_dph = 0.01 + 1e-4 * gyro_c + np.array(sensitivity) * slope + swing + noise
        run = min(cycle, runs - 1)
        rows.append(
            DwellRow(
                unit="1001",
                run=f"run {run}",
                dwell=number + 1,
                cycle=cycle + 1,
                position=[*POSITIONS][(5 * number) % 6],
                start_s=start_s,
                end_s=start_s + 1800.0,
                since_power_on_s=start_s + 600.0 - run * DWELLS_A_CYCLE * 1800.0,
                gyro_c=tuple(gyro_c),
                gyro_rate_c_per_h=(slope,) * 3,
                bias_dph=tuple(bias_dph),
                sigma_dph=(SIGMA_DPH,) * 3,
                board_c=tuple(gyro_c + 11.0 + 2.0 * random.standard_normal(3)) if boards else (np.nan,) * 3,
            )
        )
    return rows


@cache
def clean():
    return close_loop(campaign_of(made_up_rows(np.zeros(3))), effects=EFFECTS)


@cache
def explained():
    return close_loop(campaign_of(made_up_rows()), effects=EFFECTS)


@cache
def ambiguous():
    return close_loop(campaign_of(made_up_rows()), effects=[*EFFECTS, TWIN])


@cache
def faint():
    """Probably not nothing, and yet no effect is significant."""
    return close_loop(campaign_of(made_up_rows(0.11 * SENSITIVITY)), effects=EFFECTS)


@cache
def unexplained():
    return close_loop(campaign_of(made_up_rows(np.zeros(3), unknown_dph=0.02)), effects=EFFECTS)


@cache
def quiet():
    """Less scatter than stated: an effect is found, and yet nothing is beyond the noise."""
    return close_loop(campaign_of(made_up_rows(0.3 * SENSITIVITY, scatter=0.5)), effects=EFFECTS)


@cache
def quiet_unexplained():
    """What is left follows something, and yet is no more than the noise."""
    return close_loop(
        campaign_of(made_up_rows(np.zeros(3), unknown_dph=0.0015, scatter=0.5)), effects=EFFECTS
    )


@cache
def without_boards():
    return close_loop(campaign_of(made_up_rows(boards=False)), effects=EFFECTS)
