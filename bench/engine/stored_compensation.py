"""The compensation stored in the INS of a unit.

A bias that the INS subtracts can't be measured, and one that it no longer subtracts reappears unnoticed. So
its compensation is compared with the one of the run after each power-on and before each alignment.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from typing import Any

from gyrobench.bench.engine.measured_unit import MeasuredUnit
from gyrobench.bench.engine.operator import ask_operator
from gyrobench.bench.engine.resume import UNKNOWN_CHECKSUM
from gyrobench.bench.engine.run_context import RunContext
from gyrobench.bench.foundations.errors import RefusedError, RunStoppedError
from gyrobench.bench.foundations.operator_name import operator_name
from gyrobench.drivers.ins.ins_status import InsStatus

_CLEAR, _KEEP, _STOP = "clear", "keep", "stop"


class StoredCompensation:
    """Makes the INS compensate what the run's job says, and nothing else.

    Answers of the operator are kept in the unit's state, so that each question is asked once.
    """

    def __init__(self, run: RunContext, unit: MeasuredUnit) -> None:
        self._run = run
        self._unit = unit
        self._required = run.job.compensation
        self._agreed: InsStatus | None = None
        self._loaded: int | None = None  #: Checksum of the run's, which may be in use without confirmation.

    def settle(self, after_power_on: bool) -> Iterator[None]:
        """Compare, ask and load; yields once a tick until the operator answers.

        Where the INS does not report whether it compensates, nothing can be compared, and the compensation is
        loaded after each power-on. Raises RunStoppedError if the operator stops the run. Raises
        InstrumentError if the INS does not accept the compensation.
        """
        ins, unit = self._unit.live.ins, self._unit
        found = unit.live.status()
        if self._agreed is not None and _same(found, self._agreed, unknown=not after_power_on):
            return
        before = self._agreed
        if found.compensation is None and before is None:
            unit.note("the INS does not report whether it compensates its gyros (ins.signals.compensation)")
        clears = self._required is not None  # no term of an earlier one may stay
        if found.compensation and (self._loaded is None or found.compensation_in_use != self._loaded):
            clears = yield from self._decide(found, appeared=before is not None)
        if clears and ins.supports("clear_compensation"):
            ins.clear_compensation()
        if self._required is not None:
            self._loaded = ins.load_compensation(self._required)
            ins.apply_compensation(self._loaded)
            unit.note(f"the compensation {self._loaded:08x} is loaded into the INS")
            load = unit.live.station.file.ins.commands.load_compensation
            if before is None and load and (note := load.extrapolation(self._required)):
                unit.note(note)
        elif before is not None and before.compensation and not found.compensation:
            unit.note("the INS has lost its stored compensation: dwells before and after differ")
        self._agreed = ins.status()
        unit.journal.record(
            "compensation",
            found=_entry(found),
            in_use=_entry(self._agreed),
            terms=None if self._required is None else list(self._required.terms()),
        )

    def _decide(self, found: InsStatus, appeared: bool) -> Generator[None, None, bool]:
        """Ask whether to clear the stored compensation; returns the answer."""
        run, unit = self._run, self._unit
        answered = unit.run.state.stored_compensation_answers
        in_use = found.compensation_in_use
        which = UNKNOWN_CHECKSUM if in_use is None else f"{in_use:08x}"
        ins = unit.live.ins
        applies = "has begun to apply" if appeared else "applies"
        what = f"The {ins.name} {applies} a stored compensation ({which})."
        can_clear = ins.supports("clear_compensation")
        if self._required is None:
            question = f"{what} Clear it, or keep it and measure the remaining biases?"
            answers = [_CLEAR, _KEEP, _STOP] if can_clear else [_KEEP, _STOP]
        elif can_clear:
            question = f"{what} Clear it before the run's compensation is loaded?"
            answers = [_CLEAR, _STOP]
        else:
            raise RefusedError(
                ins.name,
                f"applies a stored compensation ({which}), and ins.commands has no clear_compensation. "
                "Clear it by hand, or map the command",
            )
        answer = answered.get(which, "")
        if answer not in answers:
            answer = yield from ask_operator(run.operator, question, answers)
            answered[which] = answer
            unit.journal.record("compensation_decided", which=which, answer=answer, operator=operator_name())
        if answer == _STOP:
            raise RunStoppedError(f"the operator answered '{answer}' to: {question}")
        if answer == _KEEP:
            unit.note(f"the biases are those that remain with the stored compensation ({which})")
        else:
            unit.note(f"clearing the stored compensation of the INS ({which})")
        return answer == _CLEAR


def _same(found: InsStatus, agreed: InsStatus, unknown: bool) -> bool:
    """Whether nothing has changed; ``unknown`` is the answer where the INS does not report it."""
    if found.compensation is None:
        return unknown
    if not (found.compensation and agreed.compensation):
        return found.compensation == agreed.compensation
    return found.compensation_in_use == agreed.compensation_in_use


def _entry(status: InsStatus) -> dict[str, Any]:
    in_use = status.compensation_in_use
    return {"active": status.compensation, "checksum": None if in_use is None else f"{in_use:08x}"}
