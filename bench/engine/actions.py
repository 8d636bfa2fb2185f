"""How each kind of step is performed.

An action is a generator that yields once a tick until its step is over; the engine ticks the
bench in between and minds the step's time limit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import replace
from functools import singledispatch
from typing import TypeVar

import numpy as np

from gyrobench.bench.bias.bias_filter import StateSpaceEstimate
from gyrobench.bench.dwells.temperatures import slopes_c_per_h
from gyrobench.bench.engine.dwell_recorder import DwellRecorder
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.operator import Operator, asked
from gyrobench.bench.foundations.errors import (
    ConnectionFailedError,
    FaultError,
    InstrumentError,
    InvalidDwellError,
    RunStoppedError,
)
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.navigation.table_axes import Angles
from gyrobench.bench.procedure.steps import (
    Align,
    AskOperator,
    Chamber,
    ChamberOff,
    GoTo,
    Navigate,
    PowerOff,
    PowerOn,
    Soak,
    Step,
    Turn,
    Wait,
)
from gyrobench.drivers.ins.attitude import EulerSequence
from gyrobench.drivers.ins.readout import Alignment, InsMode

Ticks = Iterator[None]
T = TypeVar("T")

#: Span over which the gyros' rate of temperature is fitted in a soak.
_SOAK_FIT_S = 600.0
_POSITION_TOLERANCE_DEG = 0.002
#: A servo may overshoot this long after its profile is complete.
_OVERSHOOT_S = 10.0
_BOOT_FRAMES_AGE_S = 2.0
#: A bus on which the INS has not been heard for so long is opened anew while it is waited for.
_DEAF_S = 15.0
#: The chamber's air has come to its set point.
_REACHED_C = 2.0
_POWER_CYCLE_S = 5.0
#: How often the biases of the dwell under way are estimated.
_ESTIMATE_EVERY_S = 30.0
#: Between a failed exchange with an instrument and the next try.
_RETRY_PAUSE_S = 2.0


class Context:
    """What actions share beyond the bench: the operator, the dwell under way, where the table is to be.

    Attributes
    ----------
    tell_estimate : callable
        Takes the estimate of the dwell under way.
    note : callable
        Takes what a person should know, for journal and screen.
    tell_retry : callable
        Takes the error of an exchange that is tried again.
    angles : tuple of float or None
        Outer and inner angle last commanded, deg.
    turns_to_come_deg : sequence of float
        The turns until the next position: a position is taken so that they have room.
    retries : int
        How often a failed exchange is tried again in the step under way.
    """

    def __init__(
        self,
        bench: LiveBench,
        operator: Operator,
        recorder: DwellRecorder,
        tell_estimate: Callable[[StateSpaceEstimate], None],
        note: Callable[[str], None],
        tell_retry: Callable[[InstrumentError], None],
    ) -> None:
        self.bench = bench
        self.operator = operator
        self.recorder = recorder
        self.tell_estimate = tell_estimate
        self.note = note
        self.tell_retry = tell_retry
        self.retries = 0
        self.angles: Angles | None = None
        self.turns_to_come_deg: Sequence[float] = ()


@singledispatch
def perform(step: Step, context: Context) -> Ticks:
    """Perform a step; see the module."""
    raise NotImplementedError(f"no action for {step.name}")


@perform.register
def _power_on(step: PowerOn, context: Context) -> Ticks:
    bench = context.bench
    if bench.station.unit.power == "operator":
        yield from _answered(context, "Switch the INS off and on, then answer.", ["on", "stop"])
    if bench.station.unit.power == "chamber_event":
        # An INS that is on already is switched off first: the time since power-on has to be known.
        bench.expected = replace(bench.expected, ins_on=False)
        yield from tried(context, lambda: bench.instruments.power_unit(False))
        yield from _lasting(bench, _POWER_CYCLE_S)
    yield from tried(context, lambda: bench.instruments.power_unit(True))
    switched_s = reopened_s = bench.clock.now()
    yield
    while not _talks(bench):
        if bench.clock.now() - reopened_s > _DEAF_S:
            reopened_s = bench.clock.now()
            bench.reopen("INS")
        yield
    bench.read_instruments()  # what was read before it spoke tells nothing of it
    bench.expected = replace(bench.expected, ins_on=True)
    bench.has_unit_restarted = False
    context.recorder.powered_on(switched_s)
    yield from _lasting(bench, step.settle_s)


@perform.register
def _power_off(step: PowerOff, context: Context) -> Ticks:  # noqa: ARG001
    bench = context.bench
    if bench.station.unit.power == "operator":
        yield from _answered(context, "Switch the INS off, then answer.", ["off", "stop"])
    bench.expected = replace(bench.expected, ins_on=bench.station.unit.power == "always_on")
    yield from tried(context, lambda: bench.instruments.power_unit(False))
    yield


@perform.register
def _chamber(step: Chamber, context: Context) -> Ticks:
    bench = context.bench
    # Each driver is looked up when it is used: a port that went away gives a new one.
    yield from tried(
        context,
        lambda: bench.instruments.chamber.set_temperature(step.temperature_c, step.ramp_c_per_min),
    )
    yield from tried(context, lambda: bench.instruments.chamber.switch(True))
    bench.expected = replace(
        bench.expected, chamber_set_c=step.temperature_c, chamber_on=True, chamber_reached=False
    )
    commanded_s = bench.clock.now()
    yield
    while (
        bench.readings.chamber_s < commanded_s
        or abs(bench.readings.chamber.temperature_c - step.temperature_c) > step.within_c
    ):
        yield
    _note_reached(bench)


@perform.register
def _chamber_off(step: ChamberOff, context: Context) -> Ticks:  # noqa: ARG001
    bench = context.bench
    yield from tried(context, lambda: bench.instruments.chamber.switch(False))
    bench.expected = replace(bench.expected, chamber_on=False, chamber_reached=False)
    yield


@perform.register
def _soak(step: Soak, context: Context) -> Ticks:
    yield from _soaking(step, context.bench)
    _note_reached(context.bench)


def _soaking(step: Soak, bench: LiveBench) -> Ticks:
    if step.for_s is not None:
        yield from _lasting(bench, step.for_s)
        return
    begin_s = bench.clock.now()
    limit = step.until_gyro_rate_below_c_per_h or 0.0
    history: deque[tuple[float, ...]] = deque()
    rate = None
    while (elapsed_s := bench.clock.now() - begin_s) < (step.at_most_s or np.inf):
        if not history or history[-1][0] < bench.readings.asked_s:
            rate = _gyro_rate_c_per_h(bench, history)
        if elapsed_s >= step.at_least_s and rate is not None and rate < limit:
            return
        yield


@perform.register
def _go_to(step: GoTo, context: Context) -> Ticks:
    if context.bench.capture:
        context.bench.end_capture()  # of an alignment that no dwell followed
    table = context.bench.station.table
    C_nb = POSITIONS[step.position].C_nb(np.deg2rad(step.azimuth_deg))
    yield from _moved(context, table.angles(C_nb, context.turns_to_come_deg), step.rate_dps)
    context.recorder.position, context.recorder.azimuth_deg = step.position, step.azimuth_deg
    yield from _lasting(context.bench, step.settle_s)


@perform.register
def _align(step: Align, context: Context) -> Ticks:
    bench = context.bench
    context.recorder.begin()
    yield from _choose_euler_sequence(step, context)
    yield from tried(context, lambda: bench.instruments.ins.align())
    begin_s = bench.clock.now()
    yield
    yield from _lasting(bench, (step.duration_s or 0.0) - (bench.clock.now() - begin_s))
    while step.until_fine and bench.instruments.ins.status().alignment is not Alignment.FINE:
        yield


@perform.register
def _navigate(step: Navigate, context: Context) -> Ticks:
    instruments = context.bench.instruments
    status = instruments.ins.status()
    if status.mode is not InsMode.NAVIGATE and context.recorder.has_window:
        context.recorder.disturb("the INS left navigation in the turn")
    elif status.mode is not InsMode.NAVIGATE:
        if status.alignment is Alignment.NONE:
            raise InvalidDwellError("the INS has not aligned, so it can't navigate. Give align more time.")
        yield from tried(context, lambda: instruments.ins.navigate())
    yield from _table_read_anew(context)
    context.recorder.begin_window()
    yield from _navigating(step, context)
    yield from _table_read_anew(context)
    context.recorder.end_window()


def _navigating(step: Navigate, context: Context) -> Ticks:
    """Until its time is over, or the biases are known well enough."""
    clock = context.bench.clock
    begin_s = clock.now()
    next_look_s = begin_s + _ESTIMATE_EVERY_S
    while clock.now() < begin_s + step.max_duration_s - 1e-6:
        if clock.now() >= next_look_s:
            next_look_s += _ESTIMATE_EVERY_S
            estimate = context.recorder.estimate_so_far()
            if estimate is not None:
                sigma_dph = float(estimate.sigma_dph.max())
                context.tell_estimate(estimate)
                if step.is_satisfied(clock.now() - begin_s, sigma_dph):
                    context.note(f"biases known to {sigma_dph:.2g} deg/h after {clock.now() - begin_s:.0f} s")
                    return
        yield
    if step.until:
        wanted_dph = step.until.bias_sigma_below_dph
        context.note(f"biases not known to {wanted_dph:g} deg/h after {step.max_duration_s:g} s: going on")


@perform.register
def _turn(step: Turn, context: Context) -> Ticks:
    if context.angles is None:
        raise FaultError("rate table", "a turn needs a position first. Put go_to before it.")
    target = context.bench.station.table.turn(context.angles, step.angle_deg)
    context.recorder.begin_turn()
    yield from _moved(context, target, step.rate_dps)
    context.recorder.end_turn()
    context.recorder.azimuth_deg += step.angle_deg
    yield from _lasting(context.bench, step.settle_s)


@perform.register
def _wait(step: Wait, context: Context) -> Ticks:
    yield from _lasting(context.bench, step.duration_s)


@perform.register
def _ask_operator(step: AskOperator, context: Context) -> Ticks:
    yield from _answered(context, step.question, step.answers)


def _note_reached(bench: LiveBench) -> None:
    """From here on the chamber's air should keep the set point that it has come to."""
    set_c, air_c = bench.commanded_c, bench.readings.chamber.temperature_c
    if set_c is not None and abs(air_c - set_c) <= _REACHED_C:
        bench.expected = replace(bench.expected, chamber_reached=True)


def _lasting(bench: LiveBench, duration_s: float) -> Ticks:
    end_s = bench.clock.now() + duration_s
    while bench.clock.now() < end_s - 1e-6:
        yield


def _answered(context: Context, question: str, answers: list[str]) -> Ticks:
    answer = yield from asked(context.operator, question, answers)
    if answer != answers[0]:
        raise RunStoppedError(f"the operator answered '{answer}' to: {question}")


def _moved(context: Context, angles: Angles, rate_dps: float) -> Ticks:
    """Move the table; one that rests elsewhere is sent again as often as the step allows."""
    context.angles = angles
    for left in range(context.retries, -1, -1):
        try:
            yield from _sent(context, angles, rate_dps)
        except _AstrayError as error:
            if not left:
                raise
            context.tell_retry(error)
        else:
            return


class _AstrayError(FaultError):
    """The table calls its motion complete and rests elsewhere."""


def _sent(context: Context, angles: Angles, rate_dps: float) -> Ticks:
    station, instruments = context.bench.station, context.bench.instruments
    yield from tried(context, lambda: instruments.table.move_to(station.by_axis_number(angles), rate_dps))
    yield
    while not (yield from tried(context, lambda: instruments.table.in_position())):
        yield
    complete_s = context.bench.clock.now()
    while True:
        reading = yield from tried(context, lambda: instruments.table.read())
        reached = station.table_axes_of(reading.position_deg)
        if np.allclose(reached, angles, rtol=0.0, atol=_POSITION_TOLERANCE_DEG):
            return
        if context.bench.clock.now() - complete_s > _OVERSHOOT_S:
            raise _AstrayError(
                "rate table",
                f"rests at outer {reached[0]:.4f}, inner {reached[1]:.4f} deg, where {angles[0]:.4f}, "
                f"{angles[1]:.4f} were commanded. Check its limits and its servo.",
            )
        yield


def tried(context: Context, exchange: Callable[[], T]) -> Generator[None, None, T]:
    """Exchange something with an instrument; what fails is tried again as often as the step allows.

    Every command of the drivers may be given twice: it names what is to be, not what is to change.
    """
    for left in range(context.retries, -1, -1):
        try:
            return exchange()
        except FaultError:
            raise
        except InstrumentError as error:
            if not left:
                raise
            context.tell_retry(error)
            if isinstance(error, ConnectionFailedError):
                context.bench.reopen(error.instrument)
            yield from _lasting(context.bench, _RETRY_PAUSE_S)
    raise AssertionError("the last try returns or raises")


def _table_read_anew(context: Context) -> Ticks:
    """Read the table now, and again at each tick until it answers."""
    begin_s = context.bench.clock.now()
    context.bench.read_table()
    while context.bench.readings.table_s < begin_s:
        yield
        context.bench.read_table()


def _talks(bench: LiveBench) -> bool:
    status = bench.instruments.ins.status()
    return status.age_s < _BOOT_FRAMES_AGE_S and status.mode is not InsMode.BOOT


def _choose_euler_sequence(step: Align, context: Context) -> Ticks:
    """Select the sequence that is regular here; an INS that can't choose keeps its own."""
    instruments = context.bench.instruments
    if not instruments.ins.supports("set_euler_sequence"):
        return
    y_is_vertical = context.recorder.position in ("y_up", "y_down")
    automatic = EulerSequence.PRY_231 if y_is_vertical else EulerSequence.RPY_321
    chosen = automatic if step.euler_sequence == "automatic" else EulerSequence(step.euler_sequence)
    if instruments.ins.status().euler_sequence is not chosen:
        yield from tried(context, lambda: instruments.ins.set_euler_sequence(chosen))


def _gyro_rate_c_per_h(bench: LiveBench, history: deque[tuple[float, ...]]) -> float | None:
    """Largest rate of the gyros' temperatures over the last minutes; None while that is too short."""
    readings = bench.readings
    if np.isnan(readings.ins.optics_c).any():
        raise InstrumentError("INS", "sends no gyro temperatures, so a soak can't wait for them. Use for_s.")
    history.append((readings.asked_s, *readings.ins.optics_c.tolist()))
    while history[-1][0] - history[0][0] > _SOAK_FIT_S:
        history.popleft()
    if history[-1][0] - history[0][0] < 0.9 * _SOAK_FIT_S:
        return None
    values = np.array(history)
    return float(np.abs(slopes_c_per_h(values[:, 0], values[:, 1:])).max())
