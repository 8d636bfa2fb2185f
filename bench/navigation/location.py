"""Location of the calibration, as stated in station files and import maps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from gyrobench.bench.foundations.arrays import STANDARD_GRAVITY
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.navigation.error_model import MAX_LATITUDE, Site

#: Standard uncertainty of normal gravity, m/s^2: a typical anomaly of 30 mGal.
NORMAL_GRAVITY_SIGMA = 3e-4
#: Largest difference of gravity from normal gravity, m/s^2, which is far above that in laboratories, and a
#: difference that does not matter.
_MAX_ANOMALY, _GRAVITY_TOLERANCE = 5e-3, 1e-4
_MAX_LATITUDE_DEG = round(math.degrees(MAX_LATITUDE), 6)


class Location(StrictModel):
    """Location of the bench."""

    renamed_keys: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"gravity_sigma_mps2": "gravity_uncertainty_mps2"}
    )

    latitude_deg: float = Field(
        description="geodetic latitude, deg; gyrocompassing fails near the poles",
        json_schema_extra={"minimum": -_MAX_LATITUDE_DEG, "maximum": _MAX_LATITUDE_DEG},
    )
    height_m: float = Field(0.0, ge=-1000.0, le=10000.0, description="height above the ellipsoid, m")
    latitude_uncertainty_arcmin: float = Field(
        0.33,
        ge=0.0,
        le=60.0,
        description="standard uncertainty of the latitude, arcmin; the default holds the "
        "deflection of the vertical to the north, 20 arcsec without an astronomical survey",
    )
    gravity_mps2: float | None = Field(
        default=None, ge=9.7, le=9.9, description="local gravity; default: normal gravity of the place"
    )
    gravity_uncertainty_mps2: float | None = Field(
        default=None,
        ge=0.0,
        le=0.1,
        description="standard uncertainty of gravity, which all scale factors of accelerometers share; "
        "default: by the digits of 'gravity_mps2', without it 3e-4",
    )

    @property
    def site(self) -> Site:
        """Latitude and height, SI."""
        return Site(float(np.deg2rad(self.latitude_deg)), self.height_m)

    @property
    def gravity_sigma(self) -> float:
        """Standard uncertainty of gravity, m/s^2: as stated, otherwise from the digits of the number."""
        if self.gravity_uncertainty_mps2 is not None:
            return self.gravity_uncertainty_mps2
        if self.gravity_mps2 is None:
            return NORMAL_GRAVITY_SIGMA
        digits = len(repr(self.gravity_mps2).partition(".")[2])
        return 0.5 * 10.0**-digits / math.sqrt(3.0)

    @property
    def gravity_caution(self) -> str:
        """Warning that normal gravity is not known as well as stated; empty if there is none."""
        if self.gravity_mps2 is not None or self.gravity_sigma >= _GRAVITY_TOLERANCE:
            return ""
        return (
            f"gravity_uncertainty_mps2 is {self.gravity_sigma:g} without gravity_mps2. Normal gravity, used "
            f"then, differs from that of a place by {NORMAL_GRAVITY_SIGMA:g} m/s^2, and by 1e-5 in 0.01 deg "
            "of latitude: enter the gravity measured there, or leave its uncertainty out"
        )

    @field_validator("latitude_deg")
    @classmethod
    def _check_latitude(cls, latitude_deg: float) -> float:
        if not abs(latitude_deg) <= _MAX_LATITUDE_DEG:
            raise ValueError(
                f"gyrocompassing fails at {latitude_deg:g} deg; allowed: -{_MAX_LATITUDE_DEG:g} to "
                f"{_MAX_LATITUDE_DEG:g} deg"
            )
        return latitude_deg

    @model_validator(mode="after")
    def _check_gravity(self) -> Self:
        if (stated := self.gravity_mps2) is None:
            return self
        normal, allowed = self.site.gravity, 2.0 * self.gravity_sigma
        deviation = abs(stated - normal)
        normal_text = (
            f"normal gravity at {self.latitude_deg:g} deg and {self.height_m:g} m is {normal:.5f} m/s^2"
        )
        if stated == STANDARD_GRAVITY and deviation > max(allowed, _GRAVITY_TOLERANCE):
            raise ValueError(
                f"{stated} m/s^2 is standard gravity, which defines the unit g; {normal_text}. Leave "
                "gravity_mps2 out, or enter the gravity measured there"
            )
        if deviation > _MAX_ANOMALY + allowed:
            raise ValueError(
                f"gravity_mps2 is {stated}; {normal_text}, from which places differ by up to "
                f"{_MAX_ANOMALY:g} m/s^2. Correct gravity, latitude or height, or leave gravity_mps2 out"
            )
        return self
