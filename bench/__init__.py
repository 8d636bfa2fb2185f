"""gyrobench: bench controller for calibrating the gyros of inertial navigation systems.

Conventions used throughout
---------------------------
Frames
    The navigation frame is East-North-Up (ENU). ``C_nb`` turns a vector of the body frame into
    the navigation frame. Attitude error ``phi`` is the misalignment of the computed against the
    true navigation frame: ``C_computed = (I - [phi x]) C_true``.
Units
    SI inside calculations (rad, s, m, rad/s); conversions happen where values enter or leave.
    Every name whose value is not in SI says so: ``_dph`` deg/h, ``_dps`` deg/s, ``_deg`` deg,
    ``_c`` degrees Celsius. Names at a boundary carry their unit in any case (``start_s``).
Time
    Seconds of the one clock of a run (:mod:`gyrobench.bench.foundations.clock`), unless a name says
    ``ins_time_s`` (the clock of the INS) or ``utc``.
"""

from typing import Any

__version__: str


def __getattr__(name: str) -> Any:
    """Find the version when it is asked for: that takes longer than to print a help text."""
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("gyrobench")
    except PackageNotFoundError:  # a source tree that was not installed
        return "0+unknown"
