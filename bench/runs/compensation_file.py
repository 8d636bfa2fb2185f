"""The compensation file: the corrections that an INS subtracts from its gyros, as YAML."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import yaml
from pydantic import Field, model_validator

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.documents import StrictModel, read_document, validate
from gyrobench.bench.foundations.files import write_whole
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.drivers.ins.compensation import PARAMETER_NAMES, Compensation, Correction

_GyroValues = Annotated[list[float], Field(min_length=3, max_length=3)]
_Vectors = Annotated[list[_GyroValues], Field(min_length=3, max_length=3)]
_Polynomials = Annotated[list[Annotated[list[float], Field(min_length=1)]], Field(min_length=3, max_length=3)]
_NumberName = Literal[
    "polynomial_dph", "rate_dph_per_c_per_h", "gradient_dph_per_k", "saturating_dph_per_k",
    "growing_dph_per_k", "onset_c", "onset_width_c", "gravity_dph_per_g", "warm_up_dph", "warm_up_s",
    "hysteresis_dph_per_k", "half_width_k",
]  # fmt: skip


class CorrectionEntry(StrictModel):
    """One other coefficient of gyro or accelerometer, in its unit: ppm, arcsec or ug."""

    polynomial: Annotated[list[float], Field(min_length=1, max_length=4)] = Field(
        description="coefficients from degree 0 up, T in degC"
    )
    rate_per_c_per_h: float = Field(0.0, description="per rate of T")
    gravity_per_g: _GyroValues = Field([0.0, 0.0, 0.0], description="along Up")
    range_c: Annotated[list[float], Field(min_length=2, max_length=2)] | None = Field(
        None, description="lowest and highest T used; default: those of the gyro of its axis"
    )


_HEAD = """\
# Compensation of the gyros x, y, z: what each subtracts. T is the temperature of its optics, B that of
# its electronics, Up the unit vector in body axes. sigma: standard uncertainty of each number; those of one
# gyro are correlated. coefficients: others of gyros and accelerometers, taken out after the biases.
"""


class CompensationFile(StrictModel):
    """Numbers of a :class:`~gyrobench.drivers.ins.compensation.Compensation`, those of each gyro in a row."""

    unit: str | int | None = Field(
        default=None, description="serial number of the only INS that gets it; by default any"
    )
    polynomial_dph: _Polynomials = Field(description="coefficients from degree 0 up, T in degC")
    low_c: _GyroValues = Field(description="lowest T used")
    high_c: _GyroValues = Field(description="highest T used")
    rate_dph_per_c_per_h: _GyroValues | None = Field(default=None, description="per rate of T")
    rate_limit_c_per_h: _GyroValues | None = Field(
        default=None, description="highest rate used, of either sign"
    )
    gradient_dph_per_k: _GyroValues | None = Field(default=None, description="per B - T")
    difference_low_k: _GyroValues | None = Field(default=None, description="lowest B - T used")
    difference_high_k: _GyroValues | None = Field(default=None, description="highest B - T used")
    saturating_dph_per_k: _Vectors | None = Field(
        default=None, description="per B - T along Up, below the onset"
    )
    growing_dph_per_k: _Vectors | None = Field(
        default=None, description="per B - T along Up, the more the colder"
    )
    onset_c: _GyroValues | None = Field(default=None, description="temperature of the onset")
    onset_width_c: _GyroValues | None = Field(default=None, description="width of the onset")
    gravity_dph_per_g: _Vectors | None = Field(default=None, description="along Up")
    warm_up_dph: _GyroValues | None = Field(default=None, description="at power-on")
    warm_up_s: _GyroValues | None = Field(default=None, description="time constant of the warm-up")
    hysteresis_dph_per_k: _GyroValues | None = Field(default=None, description="per play of T, less T")
    half_width_k: _GyroValues | None = Field(default=None, description="half width of the play")
    sigma: dict[_NumberName, _Polynomials | _GyroValues] | None = Field(
        default=None, description="standard uncertainty of each number, by its key; an INS does not get them"
    )

    coefficients: dict[str, CorrectionEntry] | None = Field(
        default=None,
        description="other coefficients by name: gyro_scale_factor_x in ppm, gyro_misalignment_xy in arcsec, "
        "accelerometer_bias_x in ug, accelerometer_scale_factor_x, accelerometer_misalignment_yx",
    )

    @model_validator(mode="after")
    def _check_consistency(self) -> Self:
        if len({len(row) for row in self.polynomial_dph}) > 1:
            raise ValueError("polynomial_dph must have as many coefficients for each gyro")
        self.compensation()
        return self

    @property
    def serial_number(self) -> str:
        """Serial number of the only INS that may get it; empty for any."""
        return str(self.unit or "")

    def compensation(self) -> Compensation:
        """Compensation that the file describes."""
        numbers = {
            name: np.array(value) for name, value in self if value is not None and name in PARAMETER_NAMES
        }
        sigma: dict[str, FloatArray] = {name: np.array(value) for name, value in (self.sigma or {}).items()}
        corrections = {
            name: Correction(
                np.array(each.polynomial),
                each.rate_per_c_per_h,
                np.array(each.gravity_per_g),
                None if each.range_c is None else (each.range_c[0], each.range_c[1]),
            )
            for name, each in (self.coefficients or {}).items()
        }
        return Compensation(**numbers, sigma=sigma, coefficients=corrections)


def write_compensation(path: Path, compensation: Compensation, unit: str = "") -> None:
    """Write a compensation file, without optional numbers that are zero for all gyros.

    ``unit``: serial number of the only INS that gets it; empty for any. Raises RunFolderError if the file
    can't be written.
    """
    values = {name: getattr(compensation, name) for name in PARAMETER_NAMES}
    required = {name for name, field in CompensationFile.model_fields.items() if field.is_required()}
    content: dict[str, Any] = {"unit": unit} if unit else {}
    content |= {name: value.tolist() for name, value in values.items() if name in required or value.any()}
    sigma = {name: value.tolist() for name, value in compensation.sigma.items() if value.any()}
    content |= {"sigma": sigma} if sigma else {}
    corrections = {
        name: _correction_entry(compensation.coefficients[name]) for name in compensation.corrections_in_use()
    }
    content |= {"coefficients": corrections} if corrections else {}
    write_whole(path, (_HEAD + yaml.safe_dump(content, sort_keys=False, default_flow_style=None)).encode())


def _correction_entry(correction: Correction) -> dict[str, Any]:
    entry = CorrectionEntry(
        polynomial=correction.polynomial.tolist(),
        rate_per_c_per_h=float(correction.rate_per_c_per_h),
        gravity_per_g=correction.gravity_per_g.tolist(),
        range_c=None if correction.range_c is None else list(correction.range_c),
    )
    return entry.model_dump(exclude_defaults=True)


def read_compensation_file(path: Path) -> CompensationFile:
    """Read a compensation file. Raises DocumentError, which lists everything wrong with it, with places."""
    return validate(read_document(path), CompensationFile)


def read_compensation(path: Path) -> Compensation:
    """Read the compensation of a file; raises as :func:`read_compensation_file`."""
    return read_compensation_file(path).compensation()


def compensations_in_use(run: RunFolder) -> list[str]:
    """Checksums of the compensations that the INS applied in a run.

    Includes one that the run loaded into an INS that does not report what it applies. Raises RunFolderError
    if the journal can't be read.
    """
    checksums = []
    for entry in read_journal(run.journal):
        if entry.get("event") != "compensation":
            continue
        in_use = entry.get("in_use", {})
        is_loaded = entry.get("terms") is not None and in_use.get("active") is None
        if in_use.get("active") or is_loaded:
            checksums.append(str(in_use.get("checksum") or "checksum unknown"))
    return list(dict.fromkeys(checksums))
