"""Bias that follows a temperature which lags behind the measured one: the sensor is elsewhere."""

from __future__ import annotations

from itertools import accumulate

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, Form, no_ins_term, time_constant
from gyrobench.bench.foundations.arrays import FloatArray


def _behind(temperature_c: FloatArray, step_s: float, tau_s: float) -> FloatArray:
    """First-order lag of a temperature (m, 3) minus that temperature, at rest before the first instant.

    Exact for a temperature that is a straight line from each instant to the next.
    """
    keep = np.exp(-step_s / tau_s)
    slopes = np.diff(temperature_c, axis=0, prepend=temperature_c[:1]) / step_s
    steps = -(1.0 - keep) * tau_s * slopes.T
    return np.array(
        [list(accumulate(each, lambda sofar, step: step + keep * sofar)) for each in steps.tolist()]
    ).T


def _columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    record = campaign.record
    behind_c = _behind(record.gyro_c, record.step_s, values[0])
    return record.mean_over(behind_c, campaign.start_s, campaign.end_s)[:, :, None]


EFFECT = Effect(
    name="thermal_lag",
    statement="the bias follows a temperature that lags behind the measured one",
    experiment=(
        "step the temperature once and soak: the bias settles a time constant later than the sensor; a "
        "second sensor closer to the cavity shows the lag directly"
    ),
    compensation=no_ins_term("the INS has no term for a temperature that lags behind"),
    forms=(
        Form(("lag behind the sensor, K",), _columns, (time_constant(1.0, 300.0, 900.0, 2700.0, 7200.0),)),
    ),
    imitated_by=("thermal_gradient",),
)
