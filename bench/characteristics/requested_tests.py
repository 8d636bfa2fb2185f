"""Section ``tests`` of a procedure: the characteristics to determine, and their settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from pydantic import Field

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.error_split import SharedErrors, SplitErrors
from gyrobench.bench.characteristics.allan_test import RateRecord, allan_test
from gyrobench.bench.characteristics.results import TestName, TestResult
from gyrobench.bench.characteristics.scale_factor import MIN_MEASUREMENTS, SpinRecord, scale_factor_stability
from gyrobench.bench.characteristics.thermal_sensitivity import thermal_sensitivity
from gyrobench.bench.characteristics.turn_on import MIN_POWER_CYCLES, turn_on_repeatability
from gyrobench.bench.characteristics.warm_up import warm_up
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import MeasurementError


class TurnOnTest(StrictModel):
    """Turn-on to turn-on repeatability."""

    min_power_cycles: int = Field(
        default=MIN_POWER_CYCLES, ge=2, le=1000, description="power cycles with dwells that the plan needs"
    )


class WarmUpTest(StrictModel):
    """Warm-up from a cold start."""

    within_dph: float = Field(
        default=0.001, gt=0.0, le=10.0, description="a gyro has settled this near to its final bias, deg/h"
    )


class ThermalTest(StrictModel):
    """Sensitivities to temperature and its rate, and hysteresis."""

    reference_c: float | None = Field(
        default=None,
        ge=-273.15,
        le=1000.0,
        description="gyro temperature of the temperature sensitivity, degC; default: the middle of the range",
    )
    degree: int = Field(default=3, ge=1, le=5, description="degree of the polynomial in temperature")


class AllanTest(StrictModel):
    """Noise from navigations with ``purpose: noise``."""


class ScaleFactorTest(StrictModel):
    """Scale factors by whole turns over hours and power cycles."""

    min_measurements: int = Field(
        default=MIN_MEASUREMENTS, ge=4, le=10_000, description="dwells with step ``spin`` that the plan needs"
    )


class CharacteristicTests(StrictModel):
    """Tests of a procedure beyond biases."""

    turn_on_repeatability: TurnOnTest | None = Field(
        default=None, description="scatter of the biases from power cycle to power cycle"
    )
    warm_up: WarmUpTest | None = Field(default=None, description="bias after a cold start")
    thermal_sensitivity: ThermalTest | None = Field(
        default=None, description="bias against temperature, its rate and direction"
    )

    allan_variance: AllanTest | None = Field(
        default=None, description="five noise coefficients, from navigations with purpose: noise"
    )
    scale_factor_stability: ScaleFactorTest | None = Field(
        default=None, description="drift and scatter of the scale factors, from dwells with step spin"
    )

    def evaluate(
        self,
        rows: Sequence[DwellRow],
        records: Sequence[RateRecord],
        spins: Sequence[SpinRecord],
        shared: SharedErrors,
        errors: SplitErrors,
    ) -> list[TestResult]:
        """Results from the dwells, noise records and whole turns of a run; a note if there are too few data.

        ``shared``: errors of the dwells due to accelerometers that follow the temperature. ``errors``: all
        errors of the dwells.
        """
        tests: dict[TestName, Callable[[Any], TestResult]] = {
            "turn_on_repeatability": lambda _: turn_on_repeatability(rows, errors),
            "warm_up": lambda test: warm_up(rows, test.within_dph, shared),
            "thermal_sensitivity": lambda test: thermal_sensitivity(
                rows, test.reference_c, test.degree, shared
            ),
            "allan_variance": lambda _: allan_test(records),
            "scale_factor_stability": lambda _: scale_factor_stability(spins),
        }
        return [
            _result(name, partial(evaluate, test))
            for name, evaluate in tests.items()
            if (test := getattr(self, name)) is not None
        ]


def _result(test: TestName, evaluate: Callable[[], TestResult]) -> TestResult:
    try:
        return evaluate()
    except MeasurementError as error:
        return TestResult(test=test, notes=[f"No result: {error}."])
