"""Numbers and names in words."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.bias.bins import BiasBin
from gyrobench.bench.foundations.text import counted, with_expanded, with_sigma
from gyrobench.bench.navigation.positions import gyro_label, position_label
from gyrobench.bench.report.number_format import (
    BiasScale,
    bins_by_temperature,
    dph_with_sigma,
    p_text,
    temperature_ranges,
)


def a_bin(low_c, **changes):
    base = BiasBin("x", "z_up", low_c, low_c + 5.0, low_c + 2.0, 0.004, 0.0009, 2, 1.0, 0.4)
    return replace(base, **changes)


def test_names_are_written_as_in_the_paper():
    assert (position_label("z_up"), gyro_label("x")) == ("Z-Up", "X gyro")


@pytest.mark.parametrize(
    ("bias_dph", "sigma_dph", "expected"),
    [
        (0.01234, 0.0009, "12.3 ± 0.9"),
        (0.01234, 0.0051, "12 ± 5"),
        (-0.01234, 0.00012, "-12.34 ± 0.12"),
        (2.5, 0.0051, "2.500 ± 0.005"),
    ],
)
def test_uncertainty_decides_the_decimals(bias_dph, sigma_dph, expected):
    assert BiasScale.of([bias_dph], [sigma_dph]).with_sigma(bias_dph, sigma_dph) == expected


def test_bias_with_its_unit_is_in_degrees_per_hour():
    assert dph_with_sigma(0.01234, 0.0009) == "0.0123 ± 0.0009 deg/h"


def test_zero_has_no_minus():
    assert BiasScale.of([0.01], [0.0009]).text(-1e-6) == "0.0"
    assert dph_with_sigma(-1e-9, 0.0009) == "0.0000 ± 0.0009 deg/h"


def test_one_has_no_plural():
    assert [counted(number, "dwell") for number in (0, 1, 2)] == ["0 dwells", "1 dwell", "2 dwells"]


def test_unit_follows_the_size_and_nan_is_passed_over():
    assert BiasScale.of([float("nan"), 0.02], [float("nan"), 0.001]).unit == "0.001 deg/h"
    assert BiasScale.of([float("nan"), -2.0], [0.001]).unit == "deg/h"


@given(st.floats(min_value=1e-7, max_value=10.0))
def test_uncertainty_never_shows_as_zero_before_the_last_decimal_allowed(sigma_dph):
    scale = BiasScale.of([0.01], [sigma_dph])
    assert float(scale.text(sigma_dph)) > 0.0 or scale.decimals == 4


@given(st.floats(min_value=0.0, max_value=1.0))
def test_p_values_are_short_and_near(p_value):
    text = p_text(p_value)
    assert len(text) <= 7
    if not text.startswith("<"):
        assert float(text) == pytest.approx(p_value, rel=0.5)


def test_neighbouring_ranges_are_joined():
    ranges = [a_bin(low) for low in (10.0, -5.0, 0.0, 20.0)]
    assert temperature_ranges(ranges) == "-5 to 5 °C, 10 to 15 °C and 20 to 25 °C"
    assert temperature_ranges(ranges[:1]) == "10 to 15 °C"


def test_empty_neighbours_become_one_range():
    bins = [
        a_bin(0.0),
        a_bin(5.0, count=0),
        a_bin(10.0, count=0),
        a_bin(15.0),
        a_bin(15.0, position="y_up", count=0),
    ]
    assert [(low, high, len(members)) for low, high, members in bins_by_temperature(bins)] == [
        (0.0, 5.0, 1),
        (5.0, 15.0, 0),
        (15.0, 20.0, 2),
    ]


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (0.000294, 0.00065, "0.0003 ± 0.0006"),
        (0.0, 0.00024, "0.00000 ± 0.00024"),
        (1.46e-5, 9.7e-6, "(1.5 ± 1.0)e-5"),
        (-2.64e-8, 3.3e-8, "(-3 ± 3)e-8"),
        (1.234e-4, 2.1e-6, "(1.234 ± 0.021)e-4"),
    ],
)
def test_a_value_has_the_decimals_of_its_uncertainty(value, sigma, text):
    assert with_sigma(value, sigma) == text


@pytest.mark.parametrize(
    ("value", "expanded", "text"),
    [
        (7.5823, 3.449, "7.6 ± 3.4"),  # one digit, 3, would be 13 % below U
        (7.5823, 1.0496, "7.6 ± 1.0"),
        (0.07, 0.0996, "0.07 ± 0.10"),
        (4321.9, 123.4, "4320 ± 120"),
        (-0.001, 99.6, "0 ± 100"),
        (12.3, 45.6, "12 ± 46"),
    ],
)
def test_an_expanded_uncertainty_has_two_digits(value, expanded, text):
    assert with_expanded(value, expanded) == text


@pytest.mark.parametrize(
    ("limit_dph", "sigma_dph", "expected"),
    [(0.006, 0.0012, "6.0"), (0.0001, 0.005, "0.1"), (0.0055, 0.005, "5.5"), (0.01, 0.005, "10")],
)
def test_limit_is_never_rounded(limit_dph, sigma_dph, expected):
    assert BiasScale.of([limit_dph], [sigma_dph]).limit_text(limit_dph) == expected


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (2.0, 3e-8, "2.00000000 ± 0.00000003"),
        (0.029, 5e-8, "(2.900000 ± 0.000005)e-2"),
        (36.0, 1e-6, "(3.60000000 ± 0.00000010)e1"),
    ],
)
def test_an_uncertainty_far_below_its_value_is_written_with_its_digits(value, sigma, text):
    assert with_sigma(value, sigma) == text
