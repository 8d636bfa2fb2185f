"""What is told: one message, as data for programs and as text for people."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from gyrobench.bench.foundations.text import listed
from gyrobench.bench.procedure.timeline import hours_minutes
from gyrobench.bench.station.receivers import EventName

#: What happened. Receivers choose among those that their key ``on`` allows; the others are for all.
Event = Literal[EventName, "guard_acted", "test"]

_S_PER_H = 3600.0
_HAPPENED = MappingProxyType(
    {
        "ends": "the run is over",
        "holds": "the run holds",
        "resumes": "the run goes on",
        "needs_person": "a person is needed",
        "guard_acted": "the run died, its guard acted",
        "test": "test message",
    }
)


@dataclass(frozen=True)
class Left:
    """What is left of a run by its plan."""

    hours: float
    dwells: int

    @property
    def text(self) -> str:
        """For people: "44:59 h, 12 dwells"."""
        return f"{hours_minutes(self.hours * _S_PER_H)} h, {self.dwells} dwells"


@dataclass(frozen=True)
class Message:
    """One message.

    Attributes
    ----------
    event : str
        What happened.
    why : str
        In words.
    station : str
        Name of the bench.
    time : datetime
        When, UTC.
    folder : Path or None
        Run folder; None where there is no run.
    procedure, unit : str
        What is run, and the serial number of the INS; empty where not known.
    ended : str
        How the run ended: "finished", "stopped" or "failed"; empty where it did not.
    question, answers : str, tuple of str
        What a person is asked, and what can be answered; empty where nothing is asked.
    left : Left or None
        None where not known.
    """

    event: Event
    why: str
    station: str
    time: datetime
    folder: Path | None = None
    procedure: str = ""
    unit: str = ""
    ended: str = ""
    question: str = ""
    answers: tuple[str, ...] = ()
    left: Left | None = None

    @property
    def is_urgent(self) -> bool:
        """Whether somebody has to do something."""
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
        """Everything, for people."""
        lines = [self.why] if self.why else []
        if self.question:
            lines.append(f"{self.question}\nAnswer with {_choice(self.answers)} at the bench's terminal.")
        if lines:
            lines.append("")
        run = f"{self.folder.name} ({self.procedure})" if self.folder and self.procedure else ""
        rows = {
            "Bench": self.station,
            "Unit": self.unit,
            "Run": run,
            "Left": self.left.text if self.left else "",
            "Time": f"{self.time:%Y-%m-%d %H:%M:%S} UTC",
            "Host": platform.node(),
            "Folder": str(self.folder or ""),
        }
        return "\n".join([*lines, *(f"{name:<7} {value}" for name, value in rows.items() if value)])

    def to_json(self) -> dict[str, Any]:
        """Plain data; the keys are always the same, null where something is not known."""
        return {
            "event": self.event,
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
            "left": {"hours": round(self.left.hours, 3), "dwells": self.left.dwells} if self.left else None,
            "urgent": self.is_urgent,
            "title": self.title,
            "text": self.text,
        }


def _choice(answers: tuple[str, ...]) -> str:
    return listed(answers).replace(" and ", " or ")
