"""Numbers and findings in words."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.bias.bins import BiasBin
from bench.bias.equality import PositionComparison, compare_positions
from bench.report.wording import (
    BiasScale,
    bins_by_temperature,
    differing,
    equality_sentence,
    gyro_label,
    p_text,
    position_label,
    scatter_sentence,
    temperature_ranges,
)

COMPARISON = PositionComparison(
    gyro="x",
    bin_low_c=20.0,
    bin_high_c=25.0,
    positions=("z_up", "y_up"),
    bias_dph=0.002,
    p_value=0.004,
    largest_pair=("y_up", "z_up"),
    largest_difference_dph=0.0123,
    largest_difference_sigma_dph=0.0013,
    temperature_spread_c=0.1,
)


def a_bin(low_c: float, **changes: object) -> BiasBin:
    base = BiasBin("x", "z_up", low_c, low_c + 5.0, low_c + 2.0, 0.004, 0.0009, 2, 1.0, 0.4)
    return replace(base, **changes)


def test_names_are_written_as_in_the_paper() -> None:
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
def test_uncertainty_decides_the_decimals(bias_dph: float, sigma_dph: float, expected: str) -> None:
    assert BiasScale.of([bias_dph], [sigma_dph]).with_sigma(bias_dph, sigma_dph) == expected


def test_unit_follows_the_size_and_nan_is_passed_over() -> None:
    assert BiasScale.of([float("nan"), 0.02], [float("nan"), 0.001]).unit == "0.001 deg/h"
    assert BiasScale.of([float("nan"), -2.0], [0.001]).unit == "deg/h"


@given(st.floats(min_value=1e-7, max_value=10.0))
def test_uncertainty_never_shows_as_zero_before_the_last_decimal_allowed(sigma_dph: float) -> None:
    scale = BiasScale.of([0.01], [sigma_dph])
    assert float(scale.text(sigma_dph)) > 0.0 or scale.decimals == 4


@given(st.floats(min_value=0.0, max_value=1.0))
def test_p_values_are_short_and_near(p_value: float) -> None:
    text = p_text(p_value)
    assert len(text) <= 7
    if not text.startswith("<"):
        assert float(text) == pytest.approx(p_value, rel=0.5)


def test_each_bin_of_a_gyro_makes_the_test_stricter() -> None:
    assert differing([COMPARISON]) == [COMPARISON]
    others = [replace(COMPARISON, bin_low_c=low, p_value=0.5) for low in (30.0, 40.0)]
    assert differing([COMPARISON, *others]) == []
    assert differing([COMPARISON, *(replace(other, gyro="y") for other in others)]) == [COMPARISON]


def test_sentence_tells_where_and_by_how_much() -> None:
    sentence = equality_sentence([COMPARISON])
    assert "in 1 of 1 bins: from 20 to 25 °C (p < 0.01, one comparison)" in sentence
    assert "Y-Up above Z-Up by 0.0123 ± 0.0013 deg/h" in sentence


def test_sentence_counts_only_the_bins_that_differ() -> None:
    hotter = replace(COMPARISON, bin_low_c=25.0, bin_high_c=30.0, p_value=0.3)
    assert equality_sentence([COMPARISON, hotter]) == (
        "The bias differs between positions in 1 of 2 bins: from 20 to 25 °C (p < 0.01, allowing for 2 "
        "comparisons). Most from 20 to 25 °C: Y-Up above Z-Up by 0.0123 ± 0.0013 deg/h."
    )


def test_sentence_says_that_nothing_was_found_or_compared() -> None:
    hotter = replace(COMPARISON, bin_low_c=25.0, bin_high_c=30.0, p_value=0.3)
    assert equality_sentence([replace(COMPARISON, p_value=0.3), hotter]) == (
        "No difference between positions found from 20 to 30 °C (no p < 0.01, allowing for 2 comparisons)."
    )
    assert equality_sentence([]).startswith("Nothing to compare")


def test_made_up_runs_are_judged_rightly(bins: list[BiasBin], equal_bins: list[BiasBin]) -> None:
    for gyro in "xyz":
        parting = compare_positions([each for each in bins if each.gyro == gyro])
        assert {each.bin_low_c for each in differing(parting)} >= {-25.0, 5.0, 15.0}
        assert all(each.bin_high_c <= 50.0 for each in differing(parting))
        agreeing = compare_positions([each for each in equal_bins if each.gyro == gyro])
        assert equality_sentence(agreeing).startswith("No difference between positions found from")


def test_neighbouring_ranges_are_joined() -> None:
    ranges = [a_bin(low) for low in (10.0, -5.0, 0.0, 20.0)]
    assert temperature_ranges(ranges) == "-5 to 5 °C, 10 to 15 °C and 20 to 25 °C"
    assert temperature_ranges(ranges[:1]) == "10 to 15 °C"


def test_empty_neighbours_become_one_range() -> None:
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


def test_scatter_is_told_only_where_uncertainties_do_not_explain_it() -> None:
    quiet = [a_bin(0.0), a_bin(5.0, count=1, spread_p_value=float("nan"))]
    assert scatter_sentence(quiet) == ""
    assert "Z-Up 10 to 15 °C." in scatter_sentence([*quiet, a_bin(10.0, spread_p_value=1e-6)])
