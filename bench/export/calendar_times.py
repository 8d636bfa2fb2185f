"""Calendar times of a run, as tables hold them."""

from __future__ import annotations

from datetime import datetime

import numpy as np
import pyarrow as pa

from gyrobench.bench.foundations.arrays import FloatArray

#: The column that has them.
UTC_FIELD = pa.field("utc", pa.timestamp("us", tz="UTC"))
_MICROSECONDS = 1e6


def calendar_times(began: datetime, time_s: FloatArray) -> pa.Array:
    """Calendar times of moments (n,) in seconds after ``began``."""
    begin_us = round(began.timestamp() * _MICROSECONDS)
    times_us = begin_us + np.rint(time_s * _MICROSECONDS).astype(np.int64)
    return pa.array(times_us, pa.int64()).cast(UTC_FIELD.type)
