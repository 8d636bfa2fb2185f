"""The measurement set-up that a station implies."""

from __future__ import annotations

import math
from functools import partial

from gyrobench.bench.dwells.dwell import MeasurementSetup
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc
from gyrobench.drivers.ins.navigation_data import decode_navigation
from gyrobench.drivers.ins.resolution import resolution_report


def measurement_setup(station: Station) -> MeasurementSetup:
    """Decoding, kinematics and noise of a station.

    Raises
    ------
    DocumentError
        The DBC file is wrong, or lacks signals that the station file maps.
    """
    codec = DbcCodec(load_dbc(station.dbc_path))
    signals = station.file.ins.signals
    limits = resolution_report(signals, codec)
    velocity_lsb_mps = max(limit.lsb for limit in limits if limit.unit == "m/s")
    heading_lsb_rad = math.radians(max(limit.lsb for limit in limits if limit.unit == "deg"))
    return MeasurementSetup(
        decode=partial(decode_navigation, signal_map=signals, codec=codec),
        table=station.table,
        noise=station.noise(velocity_lsb_mps, heading_lsb_rad),
        velocity_lsb_mps=velocity_lsb_mps,
        heading_lsb_rad=heading_lsb_rad,
        site=station.site,
        prior=station.prior(),
        resolution=tuple(limits),
    )
