"""The compensation stored in the INS of a unit.

A bias that the INS subtracts can't be measured, and one that it no longer subtracts reappears unnoticed.
Therefore its compensation is compared with that of the run after each power-on and before each alignment.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from typing import Any

from gyrobench.bench.engine.measured_unit import MeasuredUnit
from gyrobench.bench.engine.operator import ask_operator
from gyrobench.bench.engine.resume_state import UNKNOWN_CHECKSUM
from gyrobench.bench.engine.run_context import RunContext
from gyrobench.bench.foundations.errors import RefusedError, RunStoppedError
from gyrobench.bench.foundations.operator_name import operator_name
from gyrobench.drivers.ins.ins_status import InsStatus

_CLEAR, _KEEP, _STOP = "clear", "keep", "stop"


class StoredCompensation:
    """Ensures that the INS applies the compensation of the run's job, and no other.

    The operator's answers are kept in the unit's state, so that each question is asked once.
    """

    def __init__(self, run: RunContext, unit: MeasuredUnit) -> None:
        self._run = run
        self._unit = unit
        self._required = run.job.compensation
        self._agreed: InsStatus | None = None
        #: Checksum of the run's compensation, which may be in use without confirmation.
        self._loaded: int | None = None

    def settle(self, after_power_on: bool) -> Iterator[None]:
        """Compare, ask and load; yields once a tick until the operator answers.

        If the INS does not report whether it compensates, nothing can be compared, and the compensation is
        loaded after each power-on. Raises RunStoppedError if the operator stops the run. Raises
        InstrumentError if the INS does not accept the compensation.
        """
        ins, unit = self._unit.live.ins, self._unit
        status = unit.live.status()
        if self._agreed is not None and _is_unchanged(status, self._agreed, if_unknown=not after_power_on):
            return
        previous = self._agreed
        if status.compensation is None and previous is None:
            unit.note(
                "the INS does not report whether it compensates its gyros (ins.signals.compensation): "
                "the biases measured are those of its output"
            )
        must_clear = self._required is not None  # no term of an earlier compensation may remain
        if status.compensation and (self._loaded is None or status.compensation_in_use != self._loaded):
            must_clear = yield from self._decide(status, appeared=previous is not None)
        if must_clear and ins.supports("clear_compensation"):
            ins.clear_compensation()
        if self._required is not None:
            self._loaded = ins.load_compensation(self._required)
            ins.apply_compensation(self._loaded)
            unit.note(f"the compensation {self._loaded:08x} is loaded into the INS")
            load = unit.live.station.file.ins.commands.load_compensation
            if previous is None and load and (note := load.extrapolation(self._required)):
                unit.note(note)
        elif previous is not None and previous.compensation and not status.compensation:
            unit.note("the INS has lost its stored compensation: dwells before and after differ")
        self._agreed = ins.status()
        unit.journal.record(
            "compensation",
            found=_entry(status),
            in_use=_entry(self._agreed),
            terms=None if self._required is None else list(self._required.terms()),
        )

    def _decide(self, status: InsStatus, appeared: bool) -> Generator[None, None, bool]:
        """Ask whether to clear the stored compensation; returns the answer."""
        run, unit = self._run, self._unit
        answers_by_checksum = unit.run.progress.stored_compensation_answers
        in_use = status.compensation_in_use
        checksum = UNKNOWN_CHECKSUM if in_use is None else f"{in_use:08x}"
        ins = unit.live.ins
        applies = "has begun to apply" if appeared else "applies"
        statement = f"The {ins.name} {applies} a stored compensation ({checksum})."
        can_clear = ins.supports("clear_compensation")
        if self._required is None:
            question = f"{statement} Clear it, or keep it and measure the remaining biases?"
            answers = [_CLEAR, _KEEP, _STOP] if can_clear else [_KEEP, _STOP]
        elif can_clear:
            question = f"{statement} Clear it before the run's compensation is loaded?"
            answers = [_CLEAR, _STOP]
        else:
            raise RefusedError(
                ins.name,
                f"applies a stored compensation ({checksum}), and ins.commands has no clear_compensation. "
                "Clear it by hand, or map the command",
            )
        answer = answers_by_checksum.get(checksum, "")
        if answer not in answers:
            answer = yield from ask_operator(run.operator, question, answers)
            answers_by_checksum[checksum] = answer
            unit.journal.record(
                "compensation_decided", which=checksum, answer=answer, operator=operator_name()
            )
        if answer == _STOP:
            raise RunStoppedError(f"the operator answered '{answer}' to: {question}")
        if answer == _KEEP:
            unit.note(f"the biases are those that remain with the stored compensation ({checksum})")
        else:
            unit.note(f"clearing the stored compensation of the INS ({checksum})")
        return answer == _CLEAR


def _is_unchanged(status: InsStatus, agreed: InsStatus, if_unknown: bool) -> bool:
    """Whether the compensation is unchanged; ``if_unknown`` if the INS does not report it."""
    if status.compensation is None:
        return if_unknown
    if not (status.compensation and agreed.compensation):
        return status.compensation == agreed.compensation
    return status.compensation_in_use == agreed.compensation_in_use


def _entry(status: InsStatus) -> dict[str, Any]:
    in_use = status.compensation_in_use
    return {"active": status.compensation, "checksum": None if in_use is None else f"{in_use:08x}"}
