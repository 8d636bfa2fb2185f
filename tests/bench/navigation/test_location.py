import contextlib
import re

import pytest
from pydantic import ValidationError

from gyrobench.bench.navigation.location import Location


@pytest.mark.parametrize(
    ("known", "sigma", "fault"),
    [
        (
            9.80665,
            None,
            "9.80665 m/s^2 is standard gravity, which defines the unit g; normal gravity at 36.4 deg",
        ),
        (
            9.81,
            None,
            "gravity_mps2 is 9.81; normal gravity at 36.4 deg and 60 m is 9.79835 m/s^2, from which",
        ),
        (9.81, 0.005, ""),  # as uncertain as it is wrong
        (9.8, None, ""),
        (9.80135, None, ""),  # an anomaly of 300 mGal
        (9.79835, 1e-6, ""),
    ],
)
def test_a_gravity_that_is_not_that_of_its_place_is_named(known, sigma, fault):
    place = {"latitude_deg": 36.4, "height_m": 60.0, "gravity_mps2": known, "gravity_uncertainty_mps2": sigma}
    with pytest.raises(ValidationError, match=re.escape(fault)) if fault else contextlib.nullcontext():
        Location.model_validate(place)


def test_standard_gravity_is_taken_where_it_is_that_of_the_place():
    Location(latitude_deg=45.5, gravity_mps2=9.80665)


@pytest.mark.parametrize(
    ("stated", "sigma"),
    [
        ({}, 3e-4),
        ({"gravity_mps2": 9.798}, 0.5e-3 / 3**0.5),
        ({"gravity_uncertainty_mps2": 1e-6}, 1e-6),
        ({"gravity_sigma_mps2": 1e-6}, 1e-6),  # its name in import maps before
    ],
)
def test_the_uncertainty_of_gravity_is_that_stated_or_that_of_its_digits(stated, sigma):
    location = Location.model_validate({"latitude_deg": 36.4, "height_m": 60.0, **stated})
    assert location.gravity_sigma == pytest.approx(sigma)
