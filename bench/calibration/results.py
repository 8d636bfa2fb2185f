"""Results of a calibration: table of coefficients, table of correlations, and a record of everything."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gyrobench.bench.calibration.coefficients import (
    COEFFICIENTS,
    NOT_OBSERVABLE,
    CoefficientEstimate,
    SensorCoefficient,
    correlation_cells,
)
from gyrobench.bench.calibration.estimator import Calibration
from gyrobench.bench.calibration.rotation_list import ExpectedUncertainties
from gyrobench.bench.calibration.spins import SpinScaleFactor
from gyrobench.bench.foundations.arrays import DEG_PER_SQRT_H_TO_SI, RADPS_TO_DPH, UG_PER_SQRT_HZ_TO_SI
from gyrobench.bench.foundations.csv_tables import RecordTable, write_text
from gyrobench.bench.foundations.files import make_folder, remove
from gyrobench.bench.navigation.earth import earth_rate_enu
from gyrobench.bench.navigation.positions import AXES

#: Scale factors of three sensors are common if their mean exceeds this, ppm, and they differ by less than
#: this share of it.
_MIN_COMMON_PPM, _MAX_SPREAD = 100.0, 0.3
_COMMON_SCALE_CAUSES = {
    "accelerometer": "gravity, a height (3.2 m a ppm), a clock of increments or a scale of the signals",
    "gyro": "a clock of rates or a scale of the signals",
}


@dataclass(frozen=True)
class CoefficientRow:
    """A row of ``coefficients.csv``; value and sigma are None if not observable."""

    coefficient: str  #: ``gyro_bias``, ``accelerometer_misalignment``, ...
    axis: str  #: Sensor axis; for misalignments, the sensor and the axis to which it is sensitive.
    value: float | None
    sigma: float | None  #: Standard uncertainty.
    unit: str
    finding: str  #: Empty or ``not observable``.


@dataclass(frozen=True, eq=False)
class RestRate:
    """Mean rate of one rest, as measured."""

    start_s: float  #: On the log's clock.
    duration_s: float
    rate_dph: float  #: Magnitude of the mean rate.
    up_rate_dph: float  #: Component of the mean rate along the specific force.
    up_sigma_dph: float  #: Standard uncertainty of both, due to noise only.


def coefficient_rows(estimate: CoefficientEstimate) -> list[CoefficientRow]:
    """Rows of ``coefficients.csv``."""
    return [
        CoefficientRow(
            each.name,
            each.axis,
            float(value) * each.per_si if is_observed else None,
            float(sigma) * each.per_si if is_observed else None,
            each.unit,
            "" if is_observed else NOT_OBSERVABLE,
        )
        for each, value, sigma, is_observed in zip(
            estimate.coefficients, estimate.values, estimate.sigmas, estimate.is_observed, strict=True
        )
    ]


def expected_rows(expected: ExpectedUncertainties) -> list[dict[str, Any]]:
    """Expected standard uncertainty of each coefficient; None if not observable."""
    return [
        {
            "coefficient": each.name,
            "axis": each.axis,
            "sigma": float(sigma) * each.per_si if is_observed else None,
            "unit": each.unit,
        }
        for each, sigma, is_observed in zip(COEFFICIENTS, expected.sigmas, expected.is_observed, strict=True)
    ]


def rest_rates(calibration: Calibration) -> list[RestRate]:
    """Mean rate of each rest."""
    rates = []
    for recording in calibration.recordings:
        for rest, rate, force in zip(recording.rests, *recording.rest_means(), strict=True):
            size = float(np.linalg.norm(force))
            duration_s = (rest.end - rest.begin) * recording.interval_s
            noise = calibration.problem.noise
            variance = noise.angle_random_walk**2 / duration_s + 2.0 * (noise.white_angle / duration_s) ** 2
            rates.append(
                RestRate(
                    recording.start_s + rest.begin * recording.interval_s,
                    duration_s,
                    float(np.linalg.norm(rate)) * RADPS_TO_DPH,
                    float(rate @ force) / size * RADPS_TO_DPH,
                    float(np.sqrt(variance @ (force / size) ** 2)) * RADPS_TO_DPH,
                )
            )
    return rates


def strongest_correlations(
    calibration: Calibration, min_correlation: float
) -> list[tuple[SensorCoefficient, SensorCoefficient, float]]:
    """Pairs of observed coefficients whose correlation is at least ``min_correlation``, strongest first."""
    correlations = calibration.correlations
    observed = np.flatnonzero(calibration.is_observed)
    pairs = [
        (calibration.coefficients[i], calibration.coefficients[j], float(correlations[i, j]))
        for i in observed
        for j in observed[observed > i]
        if abs(correlations[i, j]) >= min_correlation
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))


def common_scale_notes(estimate: CoefficientEstimate) -> list[str]:
    """Notes on scale factors that three sensors have in common, as one wrong input causes; empty for none."""
    notes = []
    for sensor, causes in _COMMON_SCALE_CAUSES.items():
        is_scale = [each.name == f"{sensor}_scale_factor" for each in estimate.coefficients]
        values = 1e6 * estimate.values[is_scale]
        mean = float(values.mean())
        is_common = abs(mean) > _MIN_COMMON_PPM and np.ptp(values) < _MAX_SPREAD * abs(mean)
        if is_common and estimate.is_observed[is_scale].all():
            notes.append(
                f"all {sensor} scale factors are about {mean:+.0f} ppm: {causes} that is wrong by the same "
                "amount has this effect"
            )
    return notes


def calibration_record(
    calibration: Calibration, spins: Sequence[SpinScaleFactor], origin: Mapping[str, Any]
) -> dict[str, Any]:
    """Record of the whole calibration, as one JSON object."""
    problem, noise = calibration.problem, calibration.problem.noise
    return {
        **origin,
        "body_frame": calibration.frame,
        "coefficients": [vars(row) for row in coefficient_rows(calibration)],
        "noise": {
            "angle_random_walk_deg_per_sqrt_h": noise.angle_random_walk / DEG_PER_SQRT_H_TO_SI,
            "white_angle_urad": noise.white_angle * 1e6,
            "velocity_random_walk_ug_per_sqrt_hz": noise.velocity_random_walk / UG_PER_SQRT_HZ_TO_SI,
            "white_velocity_mmps": noise.white_velocity * 1e3,
        },
        "gravity_mps2": problem.gravity,
        "gravity_sigma_mps2": problem.options.gravity_sigma,
        "earth_rate_up_dph": earth_rate_enu(problem.site.latitude)[2] * RADPS_TO_DPH,
        "rests": [vars(rest) for rest in rest_rates(calibration)],
        "rotations": [
            {
                "start_s": recording.start_s + rotation.start_s,
                "duration_s": rotation.duration_s,
                "axis": AXES[rotation.axis],
                "angle_deg": float(np.rad2deg(rotation.path)),
                "kind": rotation.kind,
            }
            for recording, rotations in zip(calibration.recordings, calibration.rotations, strict=True)
            for rotation in rotations
        ],
        "spins": [asdict(each) for each in spins],
        "fit": vars(calibration.fit),
        "findings": list(calibration.findings),
    }


def write_calibration(folder: Path, calibration: Calibration, record: Mapping[str, Any]) -> list[Path]:
    """Write ``coefficients.csv``, ``correlations.csv`` and ``calibration.json``; returns the paths.

    The last one is written after the others. Raises RunFolderError if a file can't be written.
    """
    texts = {
        "coefficients.csv": RecordTable(CoefficientRow).format(coefficient_rows(calibration)),
        "correlations.csv": _correlations_table(calibration),
        "calibration.json": json.dumps(record, indent=1, ensure_ascii=False) + "\n",
    }
    make_folder(folder)
    for name in reversed(texts):
        remove(folder / name)  # so that files of two calibrations are never mixed
    for name, text in texts.items():
        write_text(folder / name, text)
    return [folder / name for name in texts]


def _correlations_table(estimate: CoefficientEstimate) -> str:
    """Text of ``correlations.csv``; cells of coefficients that are not observed are empty."""
    names = [f"{each.name}_{each.axis}" for each in estimate.coefficients]
    observed = np.outer(estimate.is_observed, estimate.is_observed)
    correlations = np.where(observed, estimate.correlations, np.nan)
    lines = [",".join(["coefficient", *names])]
    lines += [
        ",".join([name, *correlation_cells(row)]) for name, row in zip(names, correlations, strict=True)
    ]
    return "\n".join(lines) + "\n"
