"""The safe state: what the bench is left in, whatever ended the run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bench.errors import InstrumentError
from bench.station.instruments import Instruments
from bench.station.station import Station


@dataclass(frozen=True)
class SafeAction:
    """One thing done on the way to the safe state, and how it went.

    Attributes
    ----------
    what : str
        The action in words.
    problem : str
        Why it failed; empty where it did not.
    """

    what: str
    problem: str = ""


def make_safe(station: Station, instruments: Instruments) -> list[SafeAction]:
    """Stop and open the table, bring chamber and unit to what the station declares as safe.

    Each action is tried whatever became of the ones before it; none raises.
    """
    safe = station.safe_state
    table, chamber = instruments.table, instruments.chamber
    actions: list[tuple[str, Callable[[], None]]] = [
        ("rate table stopped", table.stop),
        ("rate table's interlocks opened", table.release),
    ]
    if safe.chamber_c is None:
        actions.append(("chamber switched off", lambda: chamber.switch(False)))
    else:
        safe_c = safe.chamber_c
        ramp = station.file.chamber.limits.ramp_c_per_min
        actions.append(
            (f"chamber's set point at {safe_c:g} degC", lambda: chamber.set_temperature(safe_c, ramp))
        )
    if safe.unit == "off":
        actions.append(("INS switched off", lambda: instruments.power_unit(False)))
    else:
        actions.append(("INS left as it is", lambda: None))
    return [_tried(what, action) for what, action in actions]


def _tried(what: str, action: Callable[[], None]) -> SafeAction:
    try:
        action()
    except InstrumentError as error:
        return SafeAction(what, str(error))
    except Exception as error:  # noqa: BLE001 - nothing may keep the next action from being tried
        return SafeAction(what, f"unexpected {type(error).__name__}: {error}")
    return SafeAction(what)
