"""What is asked of an instrument to record it: nothing that moves or heats."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from gyrobench.bench.foundations.errors import InstrumentError
from gyrobench.drivers.chamber import Chamber
from gyrobench.drivers.rate_table import RateTable
from gyrobench.drivers.recording.document import Call

TABLE_QUESTIONS = tuple(Call(ask=name) for name in ("identify", "faults", "limits", "read", "identify"))
CHAMBER_QUESTIONS = tuple(
    Call(ask=name) for name in ("identify", "alarms", "read", "limits_c", "set_point_c")
)


def answered(driver: RateTable | Chamber, questions: Iterable[Call]) -> Iterator[Call]:
    """Ask a driver, and tell each question with what the driver made of the reply.

    What a question gave or failed with before is not looked at.
    """
    for question in questions:
        asked = question.model_copy(update={"gives": None, "fails": None})
        try:
            result = getattr(driver, question.ask)(**question.arguments)
        except InstrumentError as error:
            yield asked.model_copy(update={"fails": type(error).__name__})
        else:
            yield asked.model_copy(update={"gives": repr(result)})
