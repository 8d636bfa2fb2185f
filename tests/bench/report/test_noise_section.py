"""What the report says of the noise of the INS."""

from __future__ import annotations

from typing import Any

import pytest

from gyrobench.bench.bias.noise_estimate import NoiseEstimate
from gyrobench.bench.report.estimator_sections import noise_section
from gyrobench.bench.report.figures.style import png_bytes
from gyrobench.bench.report.page import Section
from tests.bench.report.made_up_noise import made_up_noise


@pytest.fixture(scope="module")
def noise() -> NoiseEstimate:
    """Random walks of 0.001 deg/sqrt(h) and 20 ug/sqrt(Hz)."""
    return made_up_noise()


def station(**noise: float) -> dict[str, Any]:
    return {"ins": {"noise": noise}}


def section_of(noise: NoiseEstimate, station: dict[str, Any]) -> Section:
    section = noise_section(noise, station)
    assert section is not None
    return section


def verdicts(section: Section) -> dict[str, str]:
    (table,) = section.tables
    assert all(len(row) == len(table.header) for row in table.rows)
    return dict(table.rows)


def test_measured_noise_stands_beside_the_declared_one(noise: NoiseEstimate) -> None:
    section = section_of(
        noise, station(angle_random_walk_deg_per_sqrt_h=0.001, velocity_random_walk_ug_per_sqrt_hz=5.0)
    )
    found = verdicts(section)
    assert [name for name in found if name.startswith("angle random walk of the")] == [
        f"angle random walk of the {axis} gyro" for axis in "xyz"
    ]
    of_all = found["angle random walk of all gyros"]
    assert of_all.startswith("0.00")
    assert of_all.endswith("deg/sqrt(h), declared 0.001 deg/sqrt(h): consistent")
    assert found["velocity random walk"].endswith("declared 5 ug/sqrt(Hz): larger than declared")


def test_what_the_station_does_not_declare_has_no_row(noise: NoiseEstimate) -> None:
    found = verdicts(section_of(noise, station(angle_random_walk_deg_per_sqrt_h=0.001)))
    assert "velocity random walk" not in found
    assert "noise of the velocity output" not in found


def test_declared_noise_of_the_output_is_compared_in_its_own_units(noise: NoiseEstimate) -> None:
    found = verdicts(
        section_of(
            noise,
            station(
                angle_random_walk_deg_per_sqrt_h=0.01, velocity_output_mps=0.002, heading_output_deg=0.001
            ),
        )
    )
    assert found["angle random walk of all gyros"].endswith("smaller than declared")
    assert "declared 0.002 m/s" in found["noise of the velocity output"]
    assert "declared 17.5 urad" in found["noise of the attitude output"]


def test_without_a_declared_noise_the_text_says_whose_was_used(noise: NoiseEstimate) -> None:
    section = section_of(noise, {"ins": {"noise": "estimated"}})
    assert section.tables == []
    assert section.paragraphs[0].endswith(
        "each dwell was evaluated with the noise estimated from its windows."
    )
    declared = section_of(noise, station(angle_random_walk_deg_per_sqrt_h=0.001))
    assert "declares no noise" not in declared.paragraphs[0]


@pytest.mark.parametrize("content", [{}, {"ins": {}}])
def test_a_station_that_is_missing_still_gives_the_figure(
    noise: NoiseEstimate, content: dict[str, Any]
) -> None:
    section = section_of(noise, content)
    (drawn,) = section.figures
    assert drawn.name == "noise"
    figure = drawn.figure()
    assert len(figure.axes) == 2
    assert png_bytes(figure).startswith(b"\x89PNG")


def test_there_is_no_section_without_an_estimate() -> None:
    assert noise_section(None, station(angle_random_walk_deg_per_sqrt_h=0.001)) is None
