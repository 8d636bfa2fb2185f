"""What the INS compensates by itself: looked at before anything is measured, so that nothing counts twice.

A bias that the INS subtracts already is not there to be measured, and one that it loses in the
middle of a run comes back unnoticed. So its compensation is compared with what is wanted after each
power-on and before each alignment.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from typing import Any

from gyrobench.bench.engine.operator import Operator, asked
from gyrobench.bench.foundations.errors import RefusedError, RunStoppedError
from gyrobench.bench.station.instruments import Instruments
from gyrobench.drivers.ins.can_bus import INSTRUMENT
from gyrobench.drivers.ins.command_map import Compensation
from gyrobench.drivers.ins.ins_status import InsStatus

_CLEAR, _KEEP, _STOP = "clear", "keep", "stop"


class CompensationWatch:
    """Sees to it that the INS compensates what is wanted, and nothing else.

    Parameters
    ----------
    wanted : Compensation or None
        What the run is to be measured with; None for nothing.
    operator : Operator
        Decides about a compensation that was there already.
    record : callable
        Takes an event of the journal and what belongs to it.
    note : callable
        Takes what a person should know.
    decided : dict of str to str
        Answers of the run so far, by the compensation found; kept on here, so that nobody is asked again.
    """

    def __init__(
        self,
        instruments: Instruments,
        wanted: Compensation | None,
        operator: Operator,
        record: Callable[..., None],
        note: Callable[[str], None],
        decided: dict[str, str],
    ) -> None:
        self._instruments = instruments
        self._wanted = wanted
        self._operator = operator
        self._record = record
        self._note = note
        self._decided = decided
        self._agreed: InsStatus | None = None

    def settle(self, after_power_on: bool) -> Iterator[None]:
        """Compare, ask and load; yields once a tick while the operator thinks.

        Where the INS does not tell whether it compensates nothing can be compared, and what is
        wanted is loaded after each power-on.

        Raises
        ------
        RunStoppedError
            The operator wants to stop.
        InstrumentError
            The INS does not take what is to be loaded.
        """
        found = self._instruments.ins.status()
        if self._agreed is not None and _same(found, self._agreed, unknown=not after_power_on):
            return
        before = self._agreed
        if found.compensation is None and before is None:
            self._note("the INS does not tell whether it compensates its gyros (ins.signals.compensation)")
        clears = self._wanted is not None  # no number of an earlier one may stay
        if found.compensation:
            clears = yield from self._decide(found, appeared=before is not None)
        if clears and self._instruments.ins.supports("clear_compensation"):
            self._instruments.ins.clear_compensation()
        if self._wanted is not None:
            checksum = self._instruments.ins.load_compensation(self._wanted)
            self._instruments.ins.apply_compensation()
            self._note(f"the INS compensates its gyros from here on ({checksum:08x})")
        elif before is not None and before.compensation and not found.compensation:
            self._note("the INS has lost the compensation that it had: dwells before and after differ")
        self._agreed = self._instruments.ins.status()
        self._record(
            "compensation",
            found=_told(found),
            in_use=_told(self._agreed),
            terms=None if self._wanted is None else list(self._wanted.terms()),
        )

    def _decide(self, found: InsStatus, appeared: bool) -> Generator[None, None, bool]:
        """Ask whether to clear what the INS compensates; returns the answer."""
        which = "a compensation" if found.compensation_in_use is None else f"{found.compensation_in_use:08x}"
        what = f"The INS compensates its gyros {'now' if appeared else 'already'} ({which})."
        can_clear = self._instruments.ins.supports("clear_compensation")
        if self._wanted is None:
            question = f"{what} Clear that, or keep it and measure what it leaves?"
            answers = [_CLEAR, _KEEP, _STOP] if can_clear else [_KEEP, _STOP]
        elif can_clear:
            question = f"{what} Clear that before another one is loaded?"
            answers = [_CLEAR, _STOP]
        else:
            raise RefusedError(
                INSTRUMENT,
                f"compensates its gyros already ({which}), and ins.commands has no clear_compensation. "
                "Clear it by hand, or map the command",
            )
        answer = self._decided.get(which, "")
        if answer not in answers:
            answer = yield from asked(self._operator, question, answers)
            self._decided[which] = answer
            self._record("compensation_decided", which=which, answer=answer)
        if answer == _STOP:
            raise RunStoppedError(f"the operator answered '{answer}' to: {question}")
        if answer == _KEEP:
            self._note(f"the biases are those that the INS's own compensation ({which}) leaves")
        else:
            self._note(f"clearing the compensation of the INS ({which})")
        return answer == _CLEAR


def _same(found: InsStatus, agreed: InsStatus, unknown: bool) -> bool:
    """Whether nothing has changed; ``unknown`` is the answer where the INS does not tell."""
    if found.compensation is None:
        return unknown
    if not (found.compensation and agreed.compensation):
        return found.compensation == agreed.compensation
    return found.compensation_in_use == agreed.compensation_in_use


def _told(status: InsStatus) -> dict[str, Any]:
    in_use = status.compensation_in_use
    return {"active": status.compensation, "checksum": None if in_use is None else f"{in_use:08x}"}
