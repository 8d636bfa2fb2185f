"""How each kind of step is performed.

An action is a generator that yields once a tick until its step is over; the engine ticks the
bench in between and minds the step's time limit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import singledispatch

import numpy as np

from bench.bias.state_space.bias_filter import StateSpaceEstimate
from bench.engine.dwell_recorder import DwellRecorder
from bench.engine.live_bench import LiveBench
from bench.engine.operator import Operator, asked
from bench.errors import FaultError, InstrumentError, RunStoppedError
from bench.measurement.temperatures import slopes_c_per_h
from bench.navigation.positions import POSITIONS
from bench.navigation.table_axes import Angles
from bench.procedure.steps import (
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
from drivers.ins.attitude import EulerSequence
from drivers.ins.readout import Alignment, InsMode

Ticks = Iterator[None]

#: Span over which the gyros' rate of temperature is fitted in a soak.
_SOAK_FIT_S = 600.0
_POSITION_TOLERANCE_DEG = 0.002
#: A servo may overshoot this long after its profile is complete.
_OVERSHOOT_S = 10.0
_BOOT_FRAMES_AGE_S = 2.0
_POWER_CYCLE_S = 5.0
#: How often the biases of the dwell under way are estimated.
_ESTIMATE_EVERY_S = 30.0


class Context:
    """What actions share beyond the bench: the operator, the dwell under way, where the table is to be.

    Attributes
    ----------
    tell_estimate : callable
        Takes the estimate of the dwell under way.
    note : callable
        Takes what a person should know, for journal and screen.
    angles : tuple of float or None
        Outer and inner angle last commanded, deg.
    turns_to_come_deg : sequence of float
        The turns until the next position: a position is taken so that they have room.
    """

    def __init__(
        self,
        bench: LiveBench,
        operator: Operator,
        recorder: DwellRecorder,
        tell_estimate: Callable[[StateSpaceEstimate], None],
        note: Callable[[str], None],
    ) -> None:
        self.bench = bench
        self.operator = operator
        self.recorder = recorder
        self.tell_estimate = tell_estimate
        self.note = note
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
        bench.instruments.power_unit(False)
        yield from _lasting(bench, _POWER_CYCLE_S)
    bench.instruments.power_unit(True)
    switched_s = bench.clock.now()
    yield
    while not _talks(bench):
        yield
    bench.ins_expected = True
    context.recorder.powered_on(switched_s)
    yield from _lasting(bench, step.settle_s)


@perform.register
def _power_off(step: PowerOff, context: Context) -> Ticks:  # noqa: ARG001
    if context.bench.station.unit.power == "operator":
        yield from _answered(context, "Switch the INS off, then answer.", ["off", "stop"])
    context.bench.ins_expected = context.bench.station.unit.power == "always_on"
    context.bench.instruments.power_unit(False)
    yield


@perform.register
def _chamber(step: Chamber, context: Context) -> Ticks:
    bench = context.bench
    bench.instruments.chamber.set_temperature(step.temperature_c, step.ramp_c_per_min)
    bench.instruments.chamber.switch(True)
    bench.chamber_set_c = step.temperature_c
    yield
    while abs(bench.readings.chamber_c - step.temperature_c) > step.within_c:
        yield


@perform.register
def _chamber_off(step: ChamberOff, context: Context) -> Ticks:  # noqa: ARG001
    context.bench.instruments.chamber.switch(False)
    context.bench.chamber_set_c = None
    yield


@perform.register
def _soak(step: Soak, context: Context) -> Ticks:
    bench = context.bench
    if step.for_s is not None:
        yield from _lasting(bench, step.for_s)
        return
    begin_s = bench.clock.now()
    limit = step.until_gyro_rate_below_c_per_h or 0.0
    history: deque[tuple[float, ...]] = deque()
    rate = None
    while (elapsed_s := bench.clock.now() - begin_s) < (step.at_most_s or np.inf):
        if not history or history[-1][0] < bench.readings.time_s:
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
    bench, ins = context.bench, context.bench.instruments.ins
    _choose_euler_sequence(step, context)
    context.recorder.begin()
    ins.align()
    begin_s = bench.clock.now()
    yield
    yield from _lasting(bench, (step.duration_s or 0.0) - (bench.clock.now() - begin_s))
    while step.until_fine and ins.status().alignment is not Alignment.FINE:
        yield


@perform.register
def _navigate(step: Navigate, context: Context) -> Ticks:
    ins = context.bench.instruments.ins
    status = ins.status()
    if status.mode is not InsMode.NAVIGATE and not context.recorder.lost_navigation():
        if status.alignment is Alignment.NONE:
            raise FaultError("INS", "has not aligned, so it can't navigate. Give align more time.")
        ins.navigate()
    context.recorder.begin_window()
    yield from _navigating(step, context)
    context.recorder.end_window()


def _navigating(step: Navigate, context: Context) -> Ticks:
    """Until its time is over, or the biases are known well enough."""
    clock = context.bench.clock
    begin_s = clock.now()
    next_look_s = begin_s + _ESTIMATE_EVERY_S
    while clock.now() < begin_s + step.longest_s - 1e-6:
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
        context.note(f"biases not known to {wanted_dph:g} deg/h after {step.longest_s:g} s: going on")


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


def _lasting(bench: LiveBench, duration_s: float) -> Ticks:
    end_s = bench.clock.now() + duration_s
    while bench.clock.now() < end_s - 1e-6:
        yield


def _answered(context: Context, question: str, answers: list[str]) -> Ticks:
    answer = yield from asked(context.operator, question, answers)
    if answer != answers[0]:
        raise RunStoppedError(f"the operator answered '{answer}' to: {question}")


def _moved(context: Context, angles: Angles, rate_dps: float) -> Ticks:
    station, table = context.bench.station, context.bench.instruments.table
    table.move_to(station.by_axis_number(angles), rate_dps)
    context.angles = angles
    yield
    while not table.in_position():
        yield
    complete_s = context.bench.clock.now()
    while not np.allclose(
        reached := station.table_axes_of(table.read().position_deg),
        angles,
        rtol=0.0,
        atol=_POSITION_TOLERANCE_DEG,
    ):
        if context.bench.clock.now() - complete_s > _OVERSHOOT_S:
            raise FaultError(
                "rate table",
                f"rests at outer {reached[0]:.4f}, inner {reached[1]:.4f} deg, where {angles[0]:.4f}, "
                f"{angles[1]:.4f} were commanded. Check its limits and its servo.",
            )
        yield


def _talks(bench: LiveBench) -> bool:
    status = bench.instruments.ins.status()
    return status.age_s < _BOOT_FRAMES_AGE_S and status.mode is not InsMode.BOOT


def _choose_euler_sequence(step: Align, context: Context) -> None:
    """Select the sequence that is regular here; an INS that can't choose keeps its own."""
    ins = context.bench.instruments.ins
    if not ins.supports("set_euler_sequence"):
        return
    y_is_vertical = context.recorder.position in ("y_up", "y_down")
    automatic = EulerSequence.PRY_231 if y_is_vertical else EulerSequence.RPY_321
    chosen = automatic if step.euler_sequence == "automatic" else EulerSequence(step.euler_sequence)
    if ins.status().euler_sequence is not chosen:
        ins.set_euler_sequence(chosen)


def _gyro_rate_c_per_h(bench: LiveBench, history: deque[tuple[float, ...]]) -> float | None:
    """Largest rate of the gyros' temperatures over the last minutes; None while that is too short."""
    readings = bench.readings
    if np.isnan(readings.ins.optics_c).any():
        raise InstrumentError("INS", "sends no gyro temperatures, so a soak can't wait for them. Use for_s.")
    history.append((readings.time_s, *readings.ins.optics_c.tolist()))
    while history[-1][0] - history[0][0] > _SOAK_FIT_S:
        history.popleft()
    if history[-1][0] - history[0][0] < 0.9 * _SOAK_FIT_S:
        return None
    values = np.array(history)
    return float(np.abs(slopes_c_per_h(values[:, 0], values[:, 1:])).max())
