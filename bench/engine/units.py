"""The units of a run, measured all at once, and the compensation stored in each.

One of several units that fails is left out of the rest of the run. A bias that the INS subtracts can't be
measured, and one that it no longer subtracts reappears unnoticed. So its compensation is compared with the
one of the run after each power-on and before each alignment.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any

from gyrobench.bench.engine.dwell_recording import DwellLedger, DwellRecorder
from gyrobench.bench.engine.interlocks.watch import Trip, text_of_trips, trip_of_error
from gyrobench.bench.engine.operator import ask_operator
from gyrobench.bench.engine.resume import UNKNOWN_CHECKSUM
from gyrobench.bench.engine.run_context import MeasuredUnit, RunContext
from gyrobench.bench.foundations.errors import (
    FaultError,
    GyrobenchError,
    InstrumentError,
    InvalidDwellError,
    RefusedError,
    RunStoppedError,
    SignalMapError,
    UnitsLostError,
)
from gyrobench.bench.foundations.operator_name import operator_name
from gyrobench.bench.runs.provenance import add_identity
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
            self._note("the INS does not report whether it compensates its gyros (ins.signals.compensation)")
        clears = self._required is not None  # no term of an earlier one may stay
        if found.compensation:
            clears = yield from self._decide(found, appeared=before is not None)
        if clears and ins.supports("clear_compensation"):
            ins.clear_compensation()
        if self._required is not None:
            checksum = ins.load_compensation(self._required)
            ins.apply_compensation()
            self._note(f"the compensation {checksum:08x} is loaded into the INS")
        elif before is not None and before.compensation and not found.compensation:
            self._note("the INS has lost its stored compensation: dwells before and after differ")
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
        answered = unit.record.state.stored_compensation_answers
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
            self._note(f"the biases are those that remain with the stored compensation ({which})")
        else:
            self._note(f"clearing the stored compensation of the INS ({which})")
        return answer == _CLEAR

    def _note(self, text: str) -> None:
        self._run.note(text, self._unit)


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


#: A trip that lasts longer is not one that passes: the unit is dropped.
_PASSES_WITHIN_S = 60.0


class Unit:
    """A unit that is being measured, with what records and measures its dwells."""

    def __init__(self, run: RunContext, measured: MeasuredUnit) -> None:
        self._run = run
        self.measured = measured
        self.record, self.live, self.journal = measured.record, measured.live, measured.journal
        self.recorder = DwellRecorder(run.bench, self.live, self.record.setup)
        self.dwells = DwellLedger(run, measured, self.recorder)
        self.compensation = StoredCompensation(run, measured)
        self.is_identified = bool(self.record.state.unit)
        self.tripped_s: float | None = None  #: since when its interlock is tripped
        self.live.state.number = self.record.state.unit or self.record.number

    def note(self, text: str) -> None:
        """Record something that the operator should know of this unit."""
        self._run.note(text, self.measured)


class Units:
    """The units of a run that are not dropped.

    A unit of several is dropped where the station's ``drop_units`` allows it: its interlock trips, its
    instrument fails, it has not aligned, or its data contradict the signal map. Where that may pass, as a
    silence, the unit is set aside first, and repeats the dwell in progress. Raises UnitsLostError when the
    last one is dropped.
    """

    def __init__(self, run: RunContext) -> None:
        self._run = run
        self._bench = run.bench
        self._may_drop = len(run.records) > 1 and run.bench.station.file.drop_units
        self.running = [Unit(run, measured) for measured in run.measured]
        self._waiting: dict[Unit, Iterator[None]] = {}  # in the step in progress
        self._aside: dict[Unit, str] = {}  # why it is not measured for the moment
        self._all_tripped_s = -math.inf  # when all were tripped at last, for long

    @property
    def measuring(self) -> list[Unit]:
        """The units that the step in progress concerns: not those set aside, or done with its dwell."""
        dwell = self._bench.state.at.dwell
        present = (unit for unit in self.running if unit not in self._aside)
        return [unit for unit in present if dwell not in unit.record.state.finished]

    @property
    def have_restarted(self) -> bool:
        """Whether the INS of one has restarted without a command."""
        return any(unit.live.state.has_restarted for unit in self.running)

    @property
    def are_on(self) -> bool:
        """Whether the INS of every one should be on."""
        return all(unit.live.state.expected.ins_on for unit in self.running)

    @property
    def dropped_events(self) -> set[int]:
        """Event outputs of the chamber that feed dropped units alone; these are not switched on again."""
        stations = self._bench.station.units
        events = {
            each.file.unit.power_event for each in stations if each.number not in self._run.state.dropped
        }
        return set(self._bench.station.power_events) - events

    def each(self, action: Callable[[Unit], Iterator[None]]) -> Iterator[None]:
        """Perform an action of each unit, all at once; yields once a tick until all are done.

        Raises what the action raises, unless the unit is dropped for it.
        """
        self._waiting = {unit: action(unit) for unit in self.measuring}
        try:
            while self._waiting:
                for unit, ticks in list(self._waiting.items()):
                    try:
                        next(ticks)
                    except StopIteration:
                        del self._waiting[unit]
                    except (InstrumentError, InvalidDwellError) as error:
                        self.fail(unit, error)
                if self._waiting:
                    yield
        finally:
            self._waiting = {}

    def drop_late(self, why: str) -> bool:
        """Drop the units that a step waits for, if others are done with it; returns whether there are any."""
        late = list(self._waiting)
        if not self._may_drop or len(late) in (0, len(self.measuring)):
            return False
        for unit in late:
            self._drop(unit, why)
        return True

    def drop_tripped(self) -> None:
        """Drop the units whose interlocks are tripped, or set them aside; take back those that are good.

        Where what is wrong with all of them lasts, but may pass, its cause may be common: the run holds.
        """
        if not self._may_drop:
            return
        now_s, found = self._bench.clock.now(), {unit: unit.live.trips() for unit in self.running}
        for unit, trips in found.items():
            unit.tripped_s = (unit.tripped_s or now_s) if trips else None
        latest_s = max(unit.tripped_s or now_s for unit in found)
        if now_s - latest_s > _PASSES_WITHIN_S and all(map(_may_pass, found.values())):
            self._all_tripped_s = now_s
            self._take_back(*self._aside)
            return
        for unit, trips in found.items():
            if trips:
                self._tripped(unit, trips, now_s)
            elif unit in self._aside and not self._is_in_dwell(unit):
                self._take_back(unit)

    def _tripped(self, unit: Unit, trips: Sequence[Trip], now_s: float) -> None:
        since_s = max(unit.tripped_s or now_s, self._all_tripped_s)
        passes = _may_pass(trips) and now_s - since_s <= _PASSES_WITHIN_S
        if not (passes and self._set_aside(unit, text_of_trips(trips))):
            self._drop(unit, text_of_trips(trips))

    def _is_in_dwell(self, unit: Unit) -> bool:
        dwell = self._bench.state.at.dwell
        return bool(dwell) and dwell not in unit.record.state.finished

    def _set_aside(self, unit: Unit, why: str) -> bool:
        """Stop measuring a unit in the dwell in progress; returns False where the dwell can't be repeated."""
        if unit in self._aside:
            return True
        if self._is_in_dwell(unit) and not unit.dwells.may_repeat(self._bench.state.at.dwell):
            return False
        self._waiting.pop(unit, None)
        self._aside[unit] = why
        unit.live.is_set_aside = True
        unit.live.end_capture()
        unit.note(f"not measured for the moment: {why}")
        return True

    def _take_back(self, *units: Unit) -> None:
        for unit in units:
            unit.live.is_set_aside = False
            del self._aside[unit]

    def identify(self, again: bool) -> None:
        """Read the serial numbers that are not known yet, or all ``again``, and check them."""
        for unit in [unit for unit in self.running if again or not unit.is_identified]:
            try:
                self._identify(unit)
            except InstrumentError as error:
                self.fail(unit, error)

    def _identify(self, unit: Unit) -> None:
        ins, known = unit.live.ins, unit.live.state.number
        identity = ins.identify()
        number = str(ins.identity().get("serial_number", unit.record.number or "unknown"))
        if known not in ("", number):
            raise FaultError(
                ins.name, f"is unit {number}, but this run measures {known}. Connect {known} again."
            )
        unit.live.state.number, unit.is_identified = number, True
        unit.journal.record("ins_identified", unit=number, identity=identity)
        self._run.observers.identified(number)
        for folder in {self._run.folder, unit.record.folder}:
            add_identity(folder, ins.name, identity)

    def settle_compensation(self, after_power_on: bool) -> Iterator[None]:
        """Compare the stored compensation of each unit with that of the run, one after another."""
        for unit in list(self.running):
            try:
                yield from unit.compensation.settle(after_power_on)
            except InstrumentError as error:
                self.fail(unit, error)

    def finish_dwell(self, dwell: int) -> bool:
        """Measure the dwell that is over; returns False where a unit has to repeat it."""
        run, is_over = self._run, True
        for unit in self.measuring:
            try:
                is_over = unit.dwells.finish() and is_over
            except SignalMapError as error:
                self.fail(unit, error)
        for unit in [unit for unit in self._aside if self._is_in_dwell(unit)]:
            unit.dwells.repeat(dwell, self._aside[unit])
            self._take_back(unit)
            is_over = False
        if is_over:
            run.state.finished.add(dwell)
            if len(run.records) > 1:
                run.journal.record("dwell_over", dwell=dwell)
        return is_over

    def may_repeat(self, dwell: int) -> bool:
        """Whether the procedure allows that a dwell with invalid data is repeated."""
        return all(unit.dwells.may_repeat(dwell) for unit in self.measuring)

    def repeats(self, dwell: int) -> int:
        """How often every unit repeated a dwell because of invalid data."""
        return min(unit.record.state.repeats[dwell] for unit in self.running)

    @property
    def is_recording(self) -> bool:
        """Whether a dwell is being recorded."""
        return any(unit.live.capture for unit in self.running)

    def end_captures(self) -> bool:
        """Stop keeping frames; returns whether any unit kept them."""
        captured = [unit for unit in self.running if unit.live.capture]
        for unit in captured:
            unit.live.end_capture()
        return bool(captured)

    def discard(self, dwell: int | None, why: str, counts: bool) -> None:
        """Discard the dwell in progress, if there is one; it is repeated.

        With ``counts``, the repeat counts against the procedure's limit.
        """
        self._take_back(*self._aside)
        measuring = self.measuring
        if dwell and self.end_captures():
            for unit in measuring:
                unit.record.state.repeats[dwell] += counts
            self._run.journal.record("dwell_given_up", dwell=dwell, why=why, counts=counts)
            self._run.observers.noted(f"dwell {dwell} is repeated: {why}")

    def skip(self, dwell: int) -> None:
        """Leave a dwell out."""
        self._take_back(*self._aside)
        self.end_captures()
        self._run.journal.record("dwell_skipped", dwell=dwell)
        for state in (self._run.state, *(unit.record.state for unit in self.running)):
            state.skipped.add(dwell)
        self._run.observers.noted(f"dwell {dwell} is skipped")

    def fail(self, unit: Unit, error: GyrobenchError) -> None:
        """Drop the unit for its error, or set it aside if the error may pass.

        Raises the error where units may not be dropped, or if it is of another instrument.
        """
        is_other = isinstance(error, InstrumentError) and error.instrument != unit.live.name
        if not self._may_drop or is_other:
            raise error
        passes = trip_of_error(error, unit.live.station).rule.resume == "automatic"
        if not (passes and self._is_in_dwell(unit) and self._set_aside(unit, str(error))):
            self._drop(unit, str(error))

    def _drop(self, unit: Unit, why: str) -> None:
        run, number = self._run, unit.record.number
        run.journal.record("unit_dropped", unit=number, why=why)
        run.state.dropped[number] = why
        self._waiting.pop(unit, None)
        self._aside.pop(unit, None)
        self.running.remove(unit)
        unit.record.outcome.ended, unit.record.outcome.reason = "failed", why
        run.observers.dropped(number, why)
        if not self.running:
            self._may_drop = False
            raise UnitsLostError(f"no unit is left. The last one, {number}, was dropped: {why}")
        unit.journal.record("run_ended", ended="failed", reason=why, safe_state=[])
        run.journal.followers.remove(unit.journal)
        self._bench.leave_out(unit.live)


def _may_pass(trips: Sequence[Trip]) -> bool:
    """Whether these are trips after which a run resumes by itself."""
    return all(trip.rule.resume == "automatic" for trip in trips)
