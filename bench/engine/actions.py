"""Performs each kind of step.

An action is a generator that yields once a tick until its step is over; the engine ticks the bench in
between and enforces the step's time limit.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from functools import cache, singledispatch

import numpy as np

from gyrobench.bench.dwells.setup_check import latitude_fault
from gyrobench.bench.dwells.temperatures import slopes_c_per_h
from gyrobench.bench.engine.bench_state import Readings
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.live_unit import BUS_SILENCE_S
from gyrobench.bench.engine.measured_unit import MeasuredUnit
from gyrobench.bench.engine.operator import ask_operator
from gyrobench.bench.engine.step_context import StepContext, Ticks
from gyrobench.bench.foundations.errors import (
    FaultError,
    InstrumentError,
    InvalidDwellError,
    RefusedError,
    RunStoppedError,
    SignalMapError,
)
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.navigation.table_axes import Angles
from gyrobench.bench.procedure.rotation_steps import RotatingStep
from gyrobench.bench.procedure.steps import (
    RATE_SPAN_S,
    Align,
    AskOperator,
    ChamberOff,
    GoTo,
    Navigate,
    PowerOff,
    PowerOn,
    SetChamber,
    Soak,
    Step,
    Turn,
    Wait,
    span,
)
from gyrobench.bench.station.instruments import CHECK_SUPPLY
from gyrobench.drivers.ins.readout import Alignment, InsMode

_POSITION_TOLERANCE_DEG = 0.002
#: A servo may be off position by overshoot for this long after its motion is complete.
_OVERSHOOT_S = 10.0
#: The bus is reopened if the INS stays silent for this long after power-on.
_REOPEN_AFTER_S = 15.0
_POWER_CYCLE_S = 5.0
#: Maximum time until an INS that boots is noticed, s.
_MAX_NOTICE_S = 4.0
#: Longest time for which an INS may send after its supply is switched off, from stored energy.
_MAX_SENDS_OFF_S = 30.0
#: Period of the bias estimates of the dwell in progress.
_ESTIMATE_PERIOD_S = 30.0


@singledispatch
def perform(step: Step, context: StepContext) -> Ticks:
    """Perform a step; yields once a tick."""
    raise NotImplementedError(f"no action for {step.name}")


@perform.register
def _power_on(step: PowerOn, context: StepContext) -> Ticks:
    bench, units = context.bench, context.units
    if bench.station.file.unit.power == "operator":
        yield from _ask_for_power_cycle(context)
    if bench.station.file.unit.power == "chamber_event":
        # An INS that is already on is switched off first: the time since power-on has to be known.
        yield from _switch_off(context)
    for unit in units.running:
        unit.live.forget()
    yield from context.with_retries(lambda: bench.instruments.power_unit(True, units.dropped_events))
    switched_s = bench.clock.now()
    yield
    yield from units.for_all(lambda unit: _wait_until_sending(unit, bench))
    bench.read_instruments()  # readings from before the INS sent data do not describe it
    bench.state.units_powered(switched_s)
    for unit in units.running:
        unit.live.state.powered()
        if bench.station.file.unit.power == "always_on":
            unit.note("the INS is always on: its time since power-on is not known and counts from this step")
    yield from context.pause(step.settle_s)
    for unit in units.running:
        if fault := latitude_fault(unit.live.status().latitude, bench.station.site):
            raise SignalMapError(f"{unit.live.name}: {fault}")


def _ask_for_power_cycle(context: StepContext) -> Ticks:
    """Ask until each INS was silent or booted meanwhile: one that works all the time was not switched off."""
    working = list(context.units.running)
    while working:
        for _ in _ask(context, "Switch the INS off and on, then answer.", ["on", "stop"]):
            working = [each for each in working if each.live.has_started()]
            yield
        for _ in context.pause(_MAX_NOTICE_S):
            if not (working := [each for each in working if each.live.has_started()]):
                break
            yield
        for unit in working:
            unit.note("the INS was not switched off: it has sent frames all the time")


def _wait_until_sending(unit: MeasuredUnit, bench: LiveBench) -> Ticks:
    reopened_s, noted = bench.clock.now(), ""
    while not unit.live.has_started():
        if bench.clock.now() - reopened_s > _REOPEN_AFTER_S:
            unit.live.check_identifiers()
            is_silent = unit.live.status().age_s > BUS_SILENCE_S
            if is_silent and not noted and (noted := unit.live.ins.describe_foreign_frames()):
                unit.note(f"the INS has not started; {noted}")
            reopened_s = bench.clock.now()
            bench.reopen(unit.live.name)
        yield


def _switch_off(context: StepContext) -> Ticks:
    """Switch the supplies off, and wait until each INS is silent, unless it is always on."""
    bench, power = context.bench, context.bench.station.file.unit.power
    bench.units_switched_off()
    yield from context.with_retries(lambda: bench.instruments.power_unit(False))
    if power == "always_on":
        return
    begin_s = bench.clock.now()
    yield from context.pause(_POWER_CYCLE_S)
    yield from context.units.for_all(lambda unit: _wait_until_silent(unit, bench, begin_s))


def _wait_until_silent(unit: MeasuredUnit, bench: LiveBench, since_s: float) -> Ticks:
    while unit.live.status().age_s < BUS_SILENCE_S:
        if bench.clock.now() - since_s > _MAX_SENDS_OFF_S:
            problem = f"still sends {_MAX_SENDS_OFF_S:.0f} s after its supply was switched off"
            raise RefusedError(unit.live.name, f"{problem}. {CHECK_SUPPLY}")
        yield


@perform.register
def _power_off(step: PowerOff, context: StepContext) -> Ticks:  # noqa: ARG001
    if context.bench.station.file.unit.power == "operator":
        yield from _ask(context, "Switch the INS off, then answer.", ["off", "stop"])
    yield from _switch_off(context)
    yield


@perform.register
def _set_chamber(step: SetChamber, context: StepContext) -> Ticks:
    bench = context.bench
    bench.state.chamber_state_unknown()
    # The driver is looked up at each use: reopening a port creates a new one.
    yield from context.with_retries(
        lambda: bench.instruments.chamber.set_temperature(step.temperature_c, step.ramp_c_per_min)
    )
    yield from context.with_retries(lambda: bench.instruments.chamber.switch(True))
    bench.state.chamber_commanded(step.temperature_c)
    commanded_s = bench.clock.now()
    yield
    while (
        bench.readings.chamber_s < commanded_s
        or abs(bench.readings.chamber.temperature_c - step.temperature_c) > step.within_c
    ):
        yield
    bench.check_set_point_reached()


@perform.register
def _chamber_off(step: ChamberOff, context: StepContext) -> Ticks:  # noqa: ARG001
    bench = context.bench
    bench.state.chamber_switching(False)
    yield from context.with_retries(lambda: bench.instruments.chamber.switch(False))
    bench.state.chamber_switched(False)
    yield


@perform.register
def _soak(step: Soak, context: StepContext) -> Ticks:
    if step.for_s is not None:
        yield from context.pause(step.for_s)
    else:
        yield from _soak_until_settled(step, context)
    context.bench.check_set_point_reached()


def _soak_until_settled(step: Soak, context: StepContext) -> Ticks:
    """Wait until no gyro's temperature changes faster than the step's limit, or its time is over.

    Yields once a tick. What follows a soak that ended by its time is measured all the same, and noted.
    """
    run, bench, units = context.run, context.bench, context.units
    begin_s, polled_s, is_new = bench.clock.now(), -math.inf, False
    histories: dict[MeasuredUnit, _GyroTemperatures] = defaultdict(_GyroTemperatures)
    while (elapsed_s := bench.clock.now() - begin_s) < (step.at_most_s or math.inf):
        if polled_s < bench.readings.polled_s:
            polled_s, is_new = bench.readings.polled_s, True
            for unit in units.measuring:
                try:
                    histories[unit].add(unit.live.name, unit.live.readings)
                except InstrumentError as error:
                    units.fail(unit, error)
        if is_new and elapsed_s >= step.at_least_s:
            is_new = False
            rates = [histories[unit].rate_c_per_h for unit in units.measuring]
            if max(rates, default=math.inf) < (step.until_gyro_rate_below_c_per_h or 0.0):
                return
        yield
    rate_c_per_h = max((each.rate_c_per_h for each in histories.values()), default=math.inf)
    is_known, limit_c_per_h = math.isfinite(rate_c_per_h), step.until_gyro_rate_below_c_per_h
    rate = f"a gyro still changes by {rate_c_per_h:.3g} degC/h" if is_known else "the rate is not known yet"
    text = (
        f"soak not settled after at_most_s ({span(step.at_most_s)}), the run continues: {rate}, "
        f"limit {limit_c_per_h:g} degC/h"
    )
    run.journal.record("soak_not_settled", text=text, rate_c_per_h=rate_c_per_h, limit_c_per_h=limit_c_per_h)
    run.observers.noted(text)


class _GyroTemperatures:
    """Temperatures of the gyros of one unit over the last ten minutes."""

    def __init__(self) -> None:
        self._history: deque[tuple[float, ...]] = deque()

    def add(self, name: str, readings: Readings) -> None:
        """Add the newest temperatures. Raises InstrumentError if the unit of this name sends none."""
        if any(map(math.isnan, readings.ins.optics_c)):
            raise InstrumentError(name, "sends no gyro temperatures for the soak to wait for. Use for_s.")
        self._history.append((readings.polled_s, *readings.ins.optics_c))
        while self._history[-1][0] - self._history[0][0] > RATE_SPAN_S:
            self._history.popleft()

    @property
    def rate_c_per_h(self) -> float:
        """Largest rate of a gyro's temperature; infinite while the span is too short."""
        if not self._history or self._history[-1][0] - self._history[0][0] < 0.9 * RATE_SPAN_S:
            return math.inf
        values = np.array(self._history)
        return float(np.abs(slopes_c_per_h(values[:, 0], values[:, 1:])).max())


@perform.register
def _go_to(step: GoTo, context: StepContext) -> Ticks:
    context.units.end_captures()  # begun by an alignment without a dwell
    table = context.bench.station.table
    C_nb = POSITIONS[step.position].C_nb(np.deg2rad(step.azimuth_deg))
    yield from _move_table(context, table.angles(C_nb, context.next_turns_deg), step.rate_dps)
    for unit in context.units.running:
        unit.live.state.table_moved_to(step.position, step.azimuth_deg)
    yield from context.pause(step.settle_s)


@perform.register
def _align(step: Align, context: StepContext) -> Ticks:
    bench = context.bench
    for unit in context.units.measuring:
        unit.recorder.begin()
    yield from context.command_all(lambda unit: unit.live.choose_euler_sequence(step.euler_sequence))
    yield from context.command_all(lambda unit: unit.live.ins.enter_stepwise(InsMode.ALIGN))
    begin_s = bench.clock.now()
    yield
    yield from context.pause((step.duration_s or 0.0) - (bench.clock.now() - begin_s))
    if step.until_fine:
        yield from context.units.for_all(_wait_until_fine)


def _wait_until_fine(unit: MeasuredUnit) -> Ticks:
    while unit.live.status().alignment is not Alignment.FINE:
        yield


@perform.register
def _navigate(step: Navigate, context: StepContext) -> Ticks:
    yield from _begin_navigation(context)
    yield from _begin_windows(context)
    yield from _wait_until_navigated(step, context)
    yield from _end_windows(context)


def _begin_windows(context: StepContext) -> Ticks:
    yield from context.read_table()
    for unit in context.units.measuring:
        unit.recorder.begin_window()


def _end_windows(context: StepContext) -> Ticks:
    yield from context.read_table()
    for unit in context.units.measuring:
        unit.recorder.end_window()


def _begin_navigation(context: StepContext) -> Ticks:
    """Start navigation of each INS; one that left it since the last window disturbs its dwell."""
    for unit in context.units.measuring:
        status = unit.live.status()
        if status.mode is InsMode.NAVIGATE or (unit.recorder.has_window and not unit.live.ins.reports_mode):
            continue
        if unit.recorder.has_window:
            unit.recorder.disturb("the INS left navigation in the turn")
        elif status.alignment is Alignment.NONE and status.mode in (InsMode.BOOT, InsMode.STANDBY):
            unit.live.state.restarted()
            reason = "the INS left its alignment. Check its supply and the CAN log."
            context.units.repeat_or_flag(unit, unit.live.ins.describe_second_node() or reason)
        elif status.alignment is Alignment.NONE:
            reason = "the INS has not aligned, so it can't navigate. Increase the duration of align."
            error = InvalidDwellError(unit.live.ins.describe_second_node() or reason)
            context.units.fail(unit, error)

    def enter_navigation(unit: MeasuredUnit) -> Ticks | None:
        has_begun = unit.live.ins.status().mode is InsMode.NAVIGATE or unit.recorder.has_window
        return None if has_begun else unit.live.ins.enter_stepwise(InsMode.NAVIGATE)

    yield from context.command_all(enter_navigation)


def _wait_until_navigated(step: Navigate, context: StepContext) -> Ticks:
    """Wait until the time is over, or the bias uncertainties are below the step's limit."""
    clock, begin_s = context.bench.clock, context.bench.clock.now()
    next_estimate_s = begin_s + _ESTIMATE_PERIOD_S
    while clock.now() < begin_s + step.max_duration_s - 1e-6:
        if clock.now() >= next_estimate_s:
            next_estimate_s += _ESTIMATE_PERIOD_S
            estimates = [cache(unit.recorder.estimate_so_far) for unit in context.units.measuring]
            for estimate in estimates[:1]:
                context.run.observers.estimable(estimate)
            current = [estimate() for estimate in estimates] if step.until else [None]
            sigma_dph = max(
                (float(each.sigma_dph.max()) if each else np.inf for each in current), default=0.0
            )
            if step.is_satisfied(clock.now() - begin_s, sigma_dph):
                context.run.note(f"biases known to {sigma_dph:.2g} deg/h after {clock.now() - begin_s:.0f} s")
                return
        yield
    if step.until:
        limit_dph = step.until.bias_sigma_below_dph
        context.run.note(
            f"biases not known to {limit_dph:g} deg/h after {step.max_duration_s:g} s: continuing"
        )


@perform.register
def _turn(step: Turn, context: StepContext) -> Ticks:
    angles_deg = context.bench.state.run_position.angles_deg
    if angles_deg is None:
        raise FaultError("rate table", "a turn needs a position first. Put go_to before it.")
    target = context.bench.station.table.turn(angles_deg, step.angle_deg)
    yield from _turn_table(context, target, step.rate_dps)
    for unit in context.units.running:
        unit.live.state.turned(step.angle_deg)
    yield from context.pause(step.settle_s)


def _turn_table(context: StepContext, target: Angles, rate_dps: float) -> Ticks:
    for unit in context.units.measuring:
        unit.recorder.begin_turn()
    yield from _move_table(context, target, rate_dps)
    for unit in context.units.measuring:
        unit.recorder.end_turn()


@perform.register
def _rotate(step: RotatingStep, context: StepContext) -> Ticks:
    """Rest before the first and after each rotation; the table is read at the start of each rest."""
    bench = context.bench
    yield from _begin_navigation(context)
    yield from _switch_increments(context, True)
    yield from _rest(step, context)
    for move, rate_dps in step.moves():
        if bench.state.run_position.angles_deg is None:
            raise FaultError("rate table", "a rotation needs a position first. Put go_to before it.")
        outer_deg, inner_deg = bench.state.run_position.angles_deg
        yield from _turn_table(context, (outer_deg + move[0], inner_deg + move[1]), rate_dps)
        yield from context.pause(step.settle_s)
        yield from _begin_navigation(context)
        yield from _rest(step, context)
    yield from _switch_increments(context, False)


def _switch_increments(context: StepContext, on: bool) -> Ticks:
    def switch(unit: MeasuredUnit) -> Ticks:
        if unit.live.ins.supports("send_increments"):
            yield from context.with_retries(lambda: unit.live.ins.send_increments(on))

    yield from context.units.for_all(switch)


def _rest(step: RotatingStep, context: StepContext) -> Ticks:
    yield from _begin_windows(context)
    yield from context.pause(step.rest_s)
    yield from _end_windows(context)


@perform.register
def _wait(step: Wait, context: StepContext) -> Ticks:
    yield from context.pause(step.duration_s)


@perform.register
def _ask_operator(step: AskOperator, context: StepContext) -> Ticks:
    yield from _ask(context, step.question, step.answers)


def _ask(context: StepContext, question: str, answers: list[str]) -> Ticks:
    context.continuing_answer, context.answer_by_command = answers[0], None
    try:
        answer = yield from ask_operator(
            context.run.operator, question, answers, lambda: context.answer_by_command
        )
    finally:
        context.continuing_answer = ""
    if answer != answers[0]:
        raise RunStoppedError(f"the operator answered '{answer}' to: {question}")


def _move_table(context: StepContext, angles: Angles, rate_dps: float) -> Ticks:
    """Move the table; if it stops off position, repeat the move as often as the step allows."""
    context.bench.state.table_commanded(angles)
    for remaining_tries in range(context.retries, -1, -1):
        try:
            yield from _move_once(context, angles, rate_dps)
        except _OffPositionError as error:
            if not remaining_tries:
                raise
            context.run.record_retry(error)
        else:
            return


class _OffPositionError(FaultError):
    """The table reports that its motion is complete, but it is off position."""


def _move_once(context: StepContext, angles: Angles, rate_dps: float) -> Ticks:
    station, instruments = context.bench.station, context.bench.instruments
    yield from context.with_retries(
        lambda: instruments.table.move_to(station.by_axis_number(angles), rate_dps)
    )
    yield
    while not (yield from context.with_retries(lambda: instruments.table.in_position())):
        yield
    complete_s = context.bench.clock.now()
    while True:
        reading = yield from context.with_retries(lambda: instruments.table.read())
        reached = station.table_axes_of(reading.position_deg)
        if np.allclose(reached, angles, rtol=0.0, atol=_POSITION_TOLERANCE_DEG):
            return
        if context.bench.clock.now() - complete_s > _OVERSHOOT_S:
            raise _OffPositionError(
                "rate table",
                f"stopped at outer {reached[0]:.4f}, inner {reached[1]:.4f} deg instead of the commanded "
                f"{angles[0]:.4f}, {angles[1]:.4f} deg. Check its limits and its servo.",
            )
        yield
