"""How fresh a picture is."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from gyrobench.bench.foundations.clock import parsed_utc
from gyrobench.bench.live.picture import RunState

#: A run writes every other second; one that is busy may take some longer.
SILENT_AFTER_S = 20.0


@dataclass(frozen=True)
class News:
    """How fresh a picture is.

    Attributes
    ----------
    age_s : float
        Since it was made; 0 where that is not known.
    is_over : bool
        Whether nothing more is to be expected.
    warning : str
        What is wrong; empty if nothing is.
    """

    age_s: float
    is_over: bool
    warning: str


def news_of(state: RunState, updated_utc: str, now: datetime) -> News:
    """Judge how fresh a picture is.

    Parameters
    ----------
    state, updated_utc
        Of the picture; the time is empty where it is not known.
    now : datetime
        The host's calendar.
    """
    age_s = _age_s(updated_utc, now)
    if state.is_over or age_s < SILENT_AFTER_S:
        return News(age_s, state.is_over, "")
    why = "The run's process is there, but it writes nothing: is it busy or stuck, or the disk full?"
    return News(age_s, False, f"No news for {age_text(age_s)}. {why}")


def age_text(age_s: float) -> str:
    """Write an age: "40 s", "12 min", "5 h", "3 days"."""
    if age_s < 120.0:
        return f"{age_s:.0f} s"
    if age_s < 7200.0:
        return f"{age_s / 60.0:.0f} min"
    return f"{age_s / 3600.0:.0f} h" if age_s < 172800.0 else f"{age_s / 86400.0:.0f} days"


def _age_s(updated_utc: str, now: datetime) -> float:
    updated = parsed_utc(updated_utc)
    return max(0.0, (now - updated).total_seconds()) if updated else 0.0
