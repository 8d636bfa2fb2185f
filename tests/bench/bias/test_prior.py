from dataclasses import fields

import numpy as np
import pytest

from gyrobench.bench.bias.prior import PriorKnowledge
from gyrobench.bench.foundations.errors import DocumentError


def test_units_of_data_sheets():
    prior = PriorKnowledge.from_datasheet(100.0, 10.0, 3600.0, 7200.0, 60.0, 3600.0)
    assert prior.accelerometer_bias == pytest.approx(9.80665e-4)
    assert prior.gyro_scale_factor == pytest.approx(1e-5)
    assert prior.gyro_misalignment == pytest.approx(np.deg2rad(1.0))
    assert prior.tilt_step == pytest.approx(np.deg2rad(2.0))
    assert prior.latitude == pytest.approx(np.deg2rad(1.0))
    assert prior.bias_slope == pytest.approx(np.deg2rad(1.0))


def test_defaults_are_the_same_in_both_units():
    plain, datasheet = PriorKnowledge(), PriorKnowledge.from_datasheet()
    for field in fields(PriorKnowledge):
        assert getattr(plain, field.name) == pytest.approx(getattr(datasheet, field.name), rel=1e-12)


def test_accelerometer_biases_are_left_to_the_data():
    assert PriorKnowledge().accelerometer_bias > 5.0 * 100.0 * 9.80665e-6


@pytest.mark.parametrize("name", [field.name for field in fields(PriorKnowledge)])
@pytest.mark.parametrize("value", [-1e-9, np.nan, np.inf])
def test_refuses_a_size_out_of_range(name, value):
    with pytest.raises(DocumentError, match=f"prior knowledge: {name} must not be negative; found"):
        PriorKnowledge(**{name: value})


def test_a_size_may_be_zero():
    assert PriorKnowledge(tilt_step=0.0).tilt_step == 0.0
