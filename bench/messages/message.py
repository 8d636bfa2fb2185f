"""One message: as data for programs and as text for people."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from gyrobench.bench.foundations.text import hours_minutes, listed
from gyrobench.bench.station.receivers import EventName

#: What happened. Receivers choose events with their key ``on``; the last two go to all.
Event = Literal[EventName, "guard_acted", "test"]

_S_PER_H = 3600.0
#: Events by their names in the data of a message, a format that receivers rely on, where these differ.
_NAMES_IN_DATA = MappingProxyType({"resumes": "goes_on"})
_HAPPENED = MappingProxyType(
    {
        "ends": "the run has ended",
        "holds": "the run holds",
        "resumes": "the run has resumed",
        "needs_person": "an operator is needed",
        "unit_dropped": "a unit was dropped, the run continues with the others",
        "guard_acted": "the run died, the guard brought the bench to its safe state",
        "test": "test message",
    }
)


@dataclass(frozen=True)
class Remaining:
    """Remaining time and dwells of a run by its plan."""

    hours: float
    dwells: int

    @property
    def text(self) -> str:
        """As "44:59 h, 12 dwells"."""
        return f"{hours_minutes(self.hours * _S_PER_H)} h, {self.dwells} dwells"


@dataclass(frozen=True)
class Message:
    """One message."""

    event: Event
    why: str  #: The event in words.
    station: str
    time: datetime  #: UTC.
    folder: Path | None = None  #: Run folder; None without a run.
    #: procedure, unit: Name of the procedure, serial number of the INS; empty where not known.
    procedure: str = ""
    unit: str = ""
    ended: str = ""  #: How the run ended: "finished", "stopped" or "failed"; empty while it has not.
    #: question, answers: Question to the operator and the answers to choose from; empty without one.
    question: str = ""
    answers: tuple[str, ...] = ()
    remaining: Remaining | None = None

    @property
    def is_urgent(self) -> bool:
        """Whether an operator has to act."""
        return self.event in ("needs_person", "guard_acted") or self.ended == "failed"

    @property
    def title(self) -> str:
        """One line of printable characters: bench, unit and what happened."""
        happened = f"the run {self.ended}" if self.ended else _HAPPENED[self.event]
        unit = f", unit {self.unit}" if self.unit else ""
        line = f"{self.station}{unit}: {happened}"
        return "".join(letter if letter.isprintable() else " " for letter in line)

    @property
    def text(self) -> str:
        """All of it as text."""
        lines = [self.why] if self.why else []
        if self.question:
            lines.append(f"{self.question}\nAnswer {_choice(self.answers)} at the terminal of the bench.")
        if lines:
            lines.append("")
        run = f"{self.folder.name} ({self.procedure})" if self.folder and self.procedure else ""
        rows = {
            "Bench": self.station,
            "Unit": self.unit,
            "Run": run,
            "Remaining": self.remaining.text if self.remaining else "",
            "Time": f"{self.time:%Y-%m-%d %H:%M:%S} UTC",
            "Host": platform.node(),
            "Folder": str(self.folder or ""),
        }
        return "\n".join([*lines, *(f"{name:<9} {value}" for name, value in rows.items() if value)])

    def to_json(self) -> dict[str, Any]:
        """Plain data, always with the same keys; null where not known."""
        return {
            "event": _NAMES_IN_DATA.get(self.event, self.event),
            "run": self.folder.name if self.folder else None,
            "unit": self.unit or None,
            "station": self.station,
            "procedure": self.procedure or None,
            "ended": self.ended or None,
            "why": self.why,
            "question": self.question or None,
            "answers": list(self.answers),
            "time": self.time.isoformat(),
            "host": platform.node(),
            "folder": str(self.folder) if self.folder else None,
            "left": {"hours": round(self.remaining.hours, 3), "dwells": self.remaining.dwells}
            if self.remaining
            else None,
            "urgent": self.is_urgent,
            "title": self.title,
            "text": self.text,
        }


def _choice(answers: tuple[str, ...]) -> str:
    return listed(answers).replace(" and ", " or ")
