"""Bias that follows a temperature which lags behind the measured one: the sensor is elsewhere."""

from __future__ import annotations

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, Form, no_ins_term, time_constant
from gyrobench.bench.closure.temperatures import lag
from gyrobench.bench.foundations.arrays import FloatArray


def _columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    record = campaign.record
    behind_c = lag(record.gyro_c, record.time_s, values[0])
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
