"""The units of a run, measured all at once; if one of several fails, the run continues without it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

from gyrobench.bench.bias.dwell_table import UNKNOWN_UNIT
from gyrobench.bench.engine.interlocks.watch import Trip, text_of_trips, trip_of_error
from gyrobench.bench.engine.live_unit import BUS_SILENCE_S
from gyrobench.bench.engine.measured_unit import MeasuredUnit
from gyrobench.bench.engine.run_context import RunContext
from gyrobench.bench.engine.stored_compensation import StoredCompensation
from gyrobench.bench.foundations.errors import (
    FaultError,
    GyrobenchError,
    InstrumentError,
    InvalidDwellError,
    SignalMapError,
    UnitsLostError,
)
from gyrobench.bench.runs.provenance import add_identity

#: A trip that lasts longer does not count as passing: the unit is dropped.
_PASSES_WITHIN_S = 60.0


class Units:
    """The units of a run that are not dropped.

    If the station's ``drop_units`` allows it, one of several units is dropped if its interlock trips, its
    instrument fails, it has not aligned, or its data contradict the signal map. If the cause may pass, such
    as a silence, the unit is first set aside, and repeats the dwell in progress. Raises UnitsLostError when
    the last one is dropped.
    """

    def __init__(self, run: RunContext) -> None:
        self._run = run
        self._bench = run.bench
        self._may_drop = len(run.units) > 1 and run.bench.station.file.drop_units
        self.running = [MeasuredUnit(run, live) for live in run.bench.units]
        self._compensations = {unit: StoredCompensation(run, unit) for unit in self.running}
        self._waiting: dict[MeasuredUnit, Iterator[None]] = {}  # actions of the step in progress
        self._all_tripped_s = -math.inf  # last time at which all had been tripped for long

    @property
    def measuring(self) -> list[MeasuredUnit]:
        """Units that take part in the step in progress: not set aside, and not done with its dwell."""
        dwell = self._bench.state.run_position.dwell
        present = (unit for unit in self.running if not unit.live.set_aside_reason)
        return [unit for unit in present if dwell not in unit.run.progress.finished]

    @property
    def have_restarted(self) -> bool:
        """Whether the INS of any unit has restarted without a command."""
        return any(unit.live.state.has_restarted for unit in self.running)

    @property
    def are_on(self) -> bool:
        """Whether the INS of every unit should be on."""
        return all(unit.live.state.expected.ins_on for unit in self.running)

    @property
    def dropped_events(self) -> set[int]:
        """Event outputs of the chamber that supply only dropped units; these are not switched on again."""
        stations = self._bench.station.units
        used_events = {
            each.file.unit.power_event for each in stations if each.number not in self._run.progress.dropped
        }
        return set(self._bench.station.power_events) - used_events

    def for_all(self, action: Callable[[MeasuredUnit], Iterator[None]]) -> Iterator[None]:
        """Perform an action for all units at once; yields once a tick until all are done.

        Raises what the action raises, unless the unit is dropped or set aside.
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

    def describe_waiting(self) -> str:
        """What the units report that a step waits for; empty if it waits for none."""
        reports = []
        for unit in self._waiting:
            status = unit.live.status()
            report = "is silent" if status.age_s > BUS_SILENCE_S else f"reports {status.mode_text}"
            reports.append(f"{unit.live.name} {report}")
        return ", ".join(reports)

    def drop_late(self, reason: str) -> bool:
        """Drop the units that a step waits for if others are done; returns whether any was dropped."""
        late = list(self._waiting)
        if not self._may_drop or len(late) in (0, len(self.measuring)):
            return False
        for unit in late:
            self._drop(unit, reason)
        return True

    def drop_tripped(self) -> None:
        """Drop units with tripped interlocks, or set them aside; take back units without a trip.

        If all of them stay tripped by something that may pass, the cause may be common: the run holds.
        """
        if not self._may_drop:
            return
        now_s, trips_by_unit = self._bench.clock.now(), {unit: unit.live.trips() for unit in self.running}
        for unit, trips in trips_by_unit.items():
            unit.tripped_s = (unit.tripped_s or now_s) if trips else None
        latest_s = max(unit.tripped_s or now_s for unit in trips_by_unit)
        if now_s - latest_s > _PASSES_WITHIN_S and all(map(_may_pass, trips_by_unit.values())):
            self._all_tripped_s = now_s
            self._take_back_all()
            return
        for unit, trips in trips_by_unit.items():
            if trips:
                self._handle_trips(unit, trips, now_s)
            elif not self._is_in_dwell(unit):
                unit.live.set_aside_reason = ""

    def _handle_trips(self, unit: MeasuredUnit, trips: Sequence[Trip], now_s: float) -> None:
        since_s = max(unit.tripped_s or now_s, self._all_tripped_s)
        may_pass = _may_pass(trips) and now_s - since_s <= _PASSES_WITHIN_S
        if not (may_pass and self._set_aside(unit, text_of_trips(trips))):
            self._drop(unit, text_of_trips(trips))

    def _is_in_dwell(self, unit: MeasuredUnit) -> bool:
        dwell = self._bench.state.run_position.dwell
        return bool(dwell) and dwell not in unit.run.progress.finished

    def _set_aside(self, unit: MeasuredUnit, reason: str, *, may_flag: bool = False) -> bool:
        """Stop measuring a unit in the dwell in progress; returns False if the dwell can't be repeated.

        ``may_flag``: whether a dwell that can't be repeated may be flagged instead.
        """
        if unit.live.set_aside_reason:
            return True
        if self._is_in_dwell(unit) and not (
            may_flag or unit.may_repeat(self._bench.state.run_position.dwell)
        ):
            return False
        self._waiting.pop(unit, None)
        unit.live.set_aside_reason = reason
        unit.live.end_capture()
        unit.note(f"temporarily not measured: {reason}")
        return True

    def _take_back_all(self) -> None:
        for unit in self.running:
            unit.live.set_aside_reason = ""

    def identify(self, again: bool) -> None:
        """Check the serial numbers: read those not known yet, or all if ``again``.

        The others are compared as sent by now: adapters that were reconnected may have exchanged names.
        """
        for unit in list(self.running):
            try:
                if again or not unit.is_identified:
                    self._identify(unit)
                elif (number := unit.live.status().identity.get("serial_number")) is not None:
                    _require_number(unit, str(number))
            except InstrumentError as error:
                self.fail(unit, error)

    def _identify(self, unit: MeasuredUnit) -> None:
        ins, expected_number = unit.live.ins, unit.live.state.number
        identity = ins.identify()
        serial_number = ins.identity().get("serial_number")
        number = expected_number or UNKNOWN_UNIT if serial_number is None else str(serial_number)
        if serial_number is None and expected_number and not unit.is_identified:
            unit.note(
                f"{ins.name} sends no serial number (ins.signals.identity.serial_number): whether another "
                "unit is connected is not checked"
            )
        _require_number(unit, number)
        unit.live.state.number, unit.is_identified = number, True
        if (expected := unit.live.station.file.ins.identity) not in identity:
            raise FaultError(
                ins.name,
                f"identifies as {identity}, which lacks {expected!r}. Connect the right one, or correct "
                "`identity` in the station file.",
            )
        unit.journal.record("ins_identified", unit=number, identity=identity)
        self._run.observers.identified(number)
        folders = {self._run.folder, unit.run.folder}
        earlier_identities = {add_identity(folder, ins.name, identity) for folder in folders} - {"", identity}
        for each in earlier_identities:
            unit.note(f"{ins.name} identifies as {identity}; before as {each}.")

    def settle_compensation(self, after_power_on: bool) -> Iterator[None]:
        """Compare the stored compensation of each unit with the run's, one unit after another."""
        for unit in list(self.running):
            ticks = self._compensations[unit].settle(after_power_on)
            try:
                while unit in self.running:  # it may be dropped meanwhile
                    yield next(ticks)
            except StopIteration:
                pass
            except InstrumentError as error:
                self.fail(unit, error)

    def finish_dwell(self, dwell: int) -> bool:
        """Measure the dwell that is over; returns False if a unit has to repeat it."""
        run, is_over = self._run, True
        for unit in self.measuring:
            try:
                is_over = unit.finish_dwell() and is_over
            except SignalMapError as error:
                self.fail(unit, error)
        set_aside = [unit for unit in self.running if unit.live.set_aside_reason]
        for unit in [unit for unit in set_aside if self._is_in_dwell(unit)]:
            reason, unit.live.set_aside_reason = unit.live.set_aside_reason, ""
            if unit.may_repeat(dwell):
                unit.repeat_dwell(dwell, reason)
                is_over = False
            else:
                unit.recorder.disturb(reason)
                unit.finish_dwell()
        if is_over:
            run.progress.finish(dwell)
            if len(run.units) > 1:
                run.journal.record("dwell_over", dwell=dwell)
        return is_over

    def may_repeat(self, dwell: int) -> bool:
        """Whether the procedure allows another repeat of a dwell with invalid data."""
        return all(unit.may_repeat(dwell) for unit in self.measuring)

    def repeats(self, dwell: int) -> int:
        """Number of times that every unit has repeated a dwell because of invalid data."""
        return min(unit.run.progress.repeats[dwell] for unit in self.running)

    @property
    def is_recording(self) -> bool:
        """Whether a dwell is being recorded."""
        return any(unit.live.capture for unit in self.running)

    def end_captures(self) -> bool:
        """Stop capturing frames; returns whether any unit was capturing."""
        captured = [unit for unit in self.running if unit.live.capture]
        for unit in captured:
            unit.live.end_capture()
        return bool(captured)

    def discard(self, dwell: int | None, reason: str, counts: bool) -> None:
        """Discard the dwell in progress, if there is one; it is repeated.

        With ``counts``, the repeat counts against the procedure's limit.
        """
        self._take_back_all()
        measuring = self.measuring
        if dwell and self.end_captures():
            for unit in measuring:
                unit.run.progress.repeats[dwell] += counts
            self._run.journal.record("dwell_given_up", dwell=dwell, why=reason, counts=counts)
            self._run.observers.noted(f"dwell {dwell} is repeated: {reason}")

    def skip(self, dwell: int) -> None:
        """Skip a dwell."""
        self._take_back_all()
        self.end_captures()
        self._run.journal.record("dwell_skipped", dwell=dwell)
        for progress in (self._run.progress, *(unit.run.progress for unit in self.running)):
            progress.skip(dwell)
        self._run.observers.noted(f"dwell {dwell} is skipped")

    def repeat_or_flag(self, unit: MeasuredUnit, reason: str) -> None:
        """Have a unit repeat the dwell in progress, or flag the dwell if it may not be repeated.

        Raises InvalidDwellError if units may not be dropped: then all repeat it.
        """
        if not self._may_drop:
            raise InvalidDwellError(reason)
        self._set_aside(unit, reason, may_flag=True)

    def fail(self, unit: MeasuredUnit, error: GyrobenchError) -> None:
        """Drop the unit for its error, or set it aside if the error may pass.

        Raises the error if units may not be dropped, or another instrument caused it.
        """
        is_other_instrument = isinstance(error, InstrumentError) and error.instrument != unit.live.name
        if not self._may_drop or is_other_instrument:
            raise error
        may_pass = trip_of_error(error, unit.live.station).rule.resume == "automatic"
        if not (may_pass and self._is_in_dwell(unit) and self._set_aside(unit, str(error))):
            self._drop(unit, str(error))

    def _drop(self, unit: MeasuredUnit, reason: str) -> None:
        run, number = self._run, unit.run.number
        run.journal.record("unit_dropped", unit=number, why=reason)
        run.progress.dropped[number] = reason
        self._waiting.pop(unit, None)
        self.running.remove(unit)
        unit.run.outcome.ended, unit.run.outcome.reason = "failed", reason
        run.observers.dropped(number, reason)
        if not self.running:
            self._may_drop = False
            raise UnitsLostError(f"no unit is left. The last one, {number}, was dropped: {reason}")
        unit.journal.record("run_ended", ended="failed", reason=reason, safe_state=[])
        run.journal.followers.remove(unit.journal)
        self._bench.leave_out(unit.live)


def _require_number(unit: MeasuredUnit, number: str) -> None:
    """Raise FaultError if the serial number is that of another unit."""
    name, expected = unit.live.name, unit.live.state.number
    if expected not in ("", number):
        mismatch = f"is unit {number}, but this run measures {expected}. Connect {expected}"
        raise FaultError(name, f"{unit.live.ins.describe_second_node() or mismatch}.")


def _may_pass(trips: Sequence[Trip]) -> bool:
    """Whether a run resumes by itself after all of these trips."""
    return all(trip.rule.resume == "automatic" for trip in trips)
