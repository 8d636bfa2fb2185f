"""The joint solutions of a run as tables: ``joint_biases.csv`` and ``joint.csv``."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from gyrobench.bench.bias.vertical_pairs import Finding, UpRate
from gyrobench.bench.foundations.arrays import RAD_TO_ARCMIN, RADPS_TO_DPH, UG_TO_MPS2
from gyrobench.bench.foundations.csv_tables import RecordTable, one_of
from gyrobench.bench.navigation.positions import AXES, POSITIONS

if TYPE_CHECKING:
    from gyrobench.bench.bias.joint_solution import JointSolution


@dataclass(frozen=True, slots=True)
class JointBiasRow:
    """Bias of one gyro in one dwell."""

    #: plateau, dwell: Number of the plateau, from 1 (column ``stop``), and of the dwell.
    plateau: int
    dwell: int
    #: position, gyro: Key of :data:`gyrobench.bench.navigation.positions.POSITIONS`; "x", "y" or "z".
    position: str
    gyro: str
    temperature_c: float  #: Mean of the gyro.
    #: single_dph, single_sigma_dph: Estimate from this dwell only.
    single_dph: float
    single_sigma_dph: float
    #: joint_dph, joint_sigma_dph: Joint estimate from all dwells of the plateau.
    joint_dph: float
    joint_sigma_dph: float
    #: corrected_dph, corrected_sigma_dph: The same with the rate Up subtracted from the vertical gyros; NaN
    #: if the correction does not apply.
    corrected_dph: float
    corrected_sigma_dph: float


@dataclass(frozen=True, slots=True)
class JointSigmas:
    """Standard uncertainties of biases, deg/h: from single dwells, and joint."""

    single_dph: array[float] = field(default_factory=lambda: array("d"))
    joint_dph: array[float] = field(default_factory=lambda: array("d"))

    @classmethod
    def of(cls, rows: Iterable[JointBiasRow]) -> dict[tuple[int, bool], JointSigmas]:
        """Uncertainties by plateau, and whether the gyro was vertical."""
        by_group: dict[tuple[int, bool], JointSigmas] = {}
        for row in rows:
            is_vertical = AXES[POSITIONS[row.position].up_axis] == row.gyro
            sigmas = by_group.setdefault((row.plateau, is_vertical), cls())
            sigmas.single_dph.append(row.single_sigma_dph)
            sigmas.joint_dph.append(row.joint_sigma_dph)
        return by_group

    @property
    def gains(self) -> list[float]:
        """Ratios of the uncertainties from single dwells to the joint ones."""
        return [single / joint for single, joint in zip(self.single_dph, self.joint_dph, strict=True)]


@dataclass(frozen=True, slots=True)
class JointPlateauRow:
    """Parameters that the dwells of one plateau share."""

    plateau: int  #: Number, from 1 (column ``stop``); 0 for all plateaus together, with only the rate Up.
    cycle: int
    dwells: int  #: Number of dwells.
    chamber_set_c: float  #: Set point; NaN if there is none.
    #: Biases of the accelerometers and their standard uncertainties.
    accelerometer_x_ug: float
    accelerometer_y_ug: float
    accelerometer_z_ug: float
    accelerometer_x_sigma_ug: float
    accelerometer_y_sigma_ug: float
    accelerometer_z_sigma_ug: float
    #: Rates fixed in the navigation frame and their standard uncertainties; NaN if not observable.
    north_rate_dph: float
    north_rate_sigma_dph: float
    up_rate_dph: float
    up_rate_sigma_dph: float
    #: Latitude error that would explain both.
    latitude_error_arcmin: float
    latitude_error_sigma_arcmin: float
    up_rate_p_value: float  #: Test that the half-differences of all gyros are equal.
    #: Cause of those of the vertical gyros: name of a :class:`gyrobench.bench.bias.vertical_pairs.Finding`.
    finding: str
    #: Test that the shared parameters fit all dwells, with the declared latitude and with any rate North.
    fit_p_value: float
    any_north_p_value: float
    #: Factor by which errors of the gyros' matrix exceed the declared ones; see
    #: :attr:`gyrobench.bench.bias.joint_solution.JointSolution.gyro_error_factor`.
    gyro_error_factor: float = math.nan
    #: Additional factor of the scale factors; see
    #: :attr:`gyrobench.bench.bias.joint_solution.JointSolution.scale_factor_ratio`.
    scale_factor_ratio: float = math.nan


def joint_bias_rows(solutions: Sequence[JointSolution], up_rate: UpRate | None) -> list[JointBiasRow]:
    """Biases of all dwells, three rows each; corrected by the rate Up of all plateaus if that applies."""
    return [row for plateau, each in enumerate(solutions, 1) for row in _bias_rows(plateau, each, up_rate)]


def joint_plateau_rows(solutions: Sequence[JointSolution], up_rate: UpRate | None) -> list[JointPlateauRow]:
    """Shared parameters of each plateau; last a row with number 0, the rate Up of all plateaus together."""
    rows = [_plateau_row(plateau, each) for plateau, each in enumerate(solutions, 1)]
    if up_rate is not None and len(solutions) > 1:
        rows.append(_all_plateaus(sum(row.dwells for row in rows), up_rate))
    return rows


_COLUMN_NAMES = {"plateau": "stop"}
#: ``joint_biases.csv``.
JOINT_BIASES_TABLE = RecordTable(
    JointBiasRow, {"position": one_of(POSITIONS), "gyro": one_of(AXES)}, _COLUMN_NAMES
)
#: ``joint.csv``.
JOINT_PLATEAUS_TABLE = RecordTable(
    JointPlateauRow, {"finding": one_of([finding.name.lower() for finding in Finding])}, _COLUMN_NAMES
)


def _bias_rows(plateau: int, solution: JointSolution, up_rate: UpRate | None) -> Iterator[JointBiasRow]:
    """Rows of the dwells of one plateau."""
    corrected = solution.corrected(up_rate) if up_rate is not None and up_rate.applies else None
    for index, dwell in enumerate(solution.dwells):
        for axis, gyro in enumerate(AXES):
            estimates = (solution.single, solution.together, corrected)
            values = [
                RADPS_TO_DPH * value
                for each in estimates
                for value in (
                    (each.bias_radps[index, axis], each.sigma_radps[index, axis])
                    if each
                    else (np.nan, np.nan)
                )
            ]
            yield JointBiasRow(
                plateau, dwell.number, dwell.position_name, gyro, dwell.gyro_c[axis], *map(float, values)
            )


def _plateau_row(plateau: int, solution: JointSolution) -> JointPlateauRow:
    first = solution.dwells[0]
    north, north_sigma = solution.north_rate
    values: dict[str, Any] = {}
    for suffix, each in zip(("", "_sigma"), solution.accelerometer_bias, strict=True):
        values |= {
            f"accelerometer_{axis}{suffix}_ug": float(a / UG_TO_MPS2)
            for axis, a in zip(AXES, each, strict=True)
        }
    return JointPlateauRow(
        plateau=plateau,
        cycle=first.cycle,
        dwells=len(solution.dwells),
        chamber_set_c=first.chamber_set_c,
        north_rate_dph=north * RADPS_TO_DPH,
        north_rate_sigma_dph=north_sigma * RADPS_TO_DPH,
        fit_p_value=solution.fit.p_value,
        any_north_p_value=solution.north_free_fit.p_value,
        gyro_error_factor=solution.gyro_error_factor,
        scale_factor_ratio=solution.scale_factor_ratio,
        **values,
        **_up_rate_values(solution.up_rate),
    )


def _all_plateaus(dwells: int, rate: UpRate) -> JointPlateauRow:
    values: dict[str, Any] = {field.name: math.nan for field in fields(JointPlateauRow)}
    return JointPlateauRow(**values | {"plateau": 0, "cycle": 0, "dwells": dwells} | _up_rate_values(rate))


def _up_rate_values(rate: UpRate) -> dict[str, Any]:
    """Columns of the rate Up and of the latitude error."""
    return {
        "up_rate_dph": rate.rate * RADPS_TO_DPH,
        "up_rate_sigma_dph": rate.sigma * RADPS_TO_DPH,
        "latitude_error_arcmin": rate.latitude_error * RAD_TO_ARCMIN,
        "latitude_error_sigma_arcmin": rate.latitude_sigma * RAD_TO_ARCMIN,
        "up_rate_p_value": rate.p_value,
        "finding": rate.finding.name.lower(),
    }
