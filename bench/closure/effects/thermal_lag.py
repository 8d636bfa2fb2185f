"""Bias that follows a temperature which lags behind the one measured: the sensor sits elsewhere."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from bench.closure.campaign import Campaign
from bench.closure.effects.effect import Effect, FloatArray, Form, Parameter, fixed


def _lagged(temperature_c: FloatArray, step_s: float, tau_s: float) -> FloatArray:
    """First-order lag of a temperature over time (m, 3), at rest before the first instant."""
    keep = np.exp(-step_s / tau_s)
    rise = temperature_c - temperature_c[0]
    lagged: FloatArray = lfilter([1.0 - keep], [1.0, -keep], rise, axis=0) + temperature_c[0]
    return lagged


def _columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    record = campaign.record
    lagged_c = _lagged(record.gyro_c, record.step_s, values[0])
    return record.mean_over(lagged_c - record.gyro_c, campaign.start_s, campaign.end_s)[:, :, None]


EFFECT = Effect(
    name="thermal_lag",
    statement="the bias follows a temperature that lags behind the measured one",
    experiment=(
        "step the temperature once and soak: the bias goes on moving for the lag's time constant after the "
        "sensor has settled; a second sensor nearer to the cavity shows the lag directly"
    ),
    forms=(
        Form(
            ("lagged temperature less the measured one, K",),
            _columns,
            (Parameter("tau_s", 60.0, 36_000.0, fixed(300.0, 900.0, 2700.0, 7200.0, 18_000.0)),),
        ),
    ),
)
