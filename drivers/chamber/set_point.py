"""What chambers that are told numbers as text can be commanded at all."""

from __future__ import annotations

from gyrobench.bench.foundations.errors import RefusedError

#: Decimals that commands are written with.
DECIMALS = 3
_LARGEST = 99_999.0


def check_commandable(instrument: str, temperature_c: float, rate_c_per_min: float | None) -> None:
    """Refuse a set point or ramp before anything has been sent.

    Raises
    ------
    RefusedError
        One is no finite number, is too large to be written, or the ramp is none.
    """
    if rate_c_per_min is not None and not _LARGEST > round(rate_c_per_min, DECIMALS) > 0.0:
        raise RefusedError(instrument, f"a ramp of {rate_c_per_min} °C/min can't be commanded")
    if not abs(temperature_c) < _LARGEST:
        raise RefusedError(instrument, f"a set point of {temperature_c} °C can't be commanded")
