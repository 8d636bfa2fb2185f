"""Checks of a plan before anything moves: order of the steps, times, and limits of the station."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.foundations.documents import Document, DocumentProblem
from gyrobench.bench.foundations.yaml_nodes import KeyPath
from gyrobench.bench.navigation.positions import POSITIONS, half_turn_pairs
from gyrobench.bench.navigation.table_axes import TurnOrMove, turn_text
from gyrobench.bench.procedure.plan import SINGLE_NAVIGATION, Plan, PlannedStep, turns_after
from gyrobench.bench.procedure.rotation_steps import RotatingStep, Spin
from gyrobench.bench.procedure.steps import (
    MIN_NAVIGATION_S,
    Align,
    GoTo,
    Navigate,
    PowerOn,
    SetChamber,
    Soak,
    Turn,
    Wait,
)


@dataclass(frozen=True)
class StationLimits:
    """Limits of one station's chamber and table; by default there are none."""

    #: chamber_low_c, chamber_high_c: Range of the chamber's set point.
    chamber_low_c: float = -math.inf
    chamber_high_c: float = math.inf
    ramp_max_c_per_min: float = math.inf  #: Fastest ramp of the chamber, up or down.
    table_rate_max_dps: float = math.inf  #: Fastest turn of either axis of the table.
    #: Reason why the table can't go to a position and azimuth, deg, and then make turns, deg; None if it can.
    unreachable_reason: Callable[[str, float, tuple[TurnOrMove, ...]], str | None] = lambda *_: None
    #: gyro_low_c, gyro_high_c: Temperatures of the gyros at which an interlock trips.
    gyro_low_c: float = -math.inf
    gyro_high_c: float = math.inf
    #: Commands that the INS of the station has.
    ins_commands: frozenset[str] = frozenset({"align", "navigate"})
    has_gyro_temperatures: bool = True  #: Whether the INS sends those of the gyros' optics.
    is_always_on: bool = False  #: Whether the INS stays on in spite of power_off.


def check_plan(document: Document, plan: Plan, limits: StationLimits | None = None) -> None:
    """Raise DocumentError with all problems of a plan that can't be run, and their places in the file.

    Without the limits of a station only the order of the steps and their times are checked.
    """
    problems = find_problems(plan, limits)
    if problems:
        raise document.error(problems)


def find_problems(plan: Plan, limits: StationLimits | None = None) -> list[DocumentProblem]:
    """All problems of a plan; see :func:`check_plan`."""
    limits = limits or StationLimits()
    # A long plan has few different attitudes.
    limits = replace(limits, unreachable_reason=cache(limits.unreachable_reason))
    problems = [*_dwell_problems(plan)]
    for planned in plan.steps:
        problems += [*_order_problems(planned), *_time_problems(planned)]
        problems += [*_chamber_problems(planned, limits), *_table_problems(planned, limits)]
        problems += [*_command_problems(planned, limits), *_reach_problems(plan, planned, limits)]
    return [*problems, *_test_problems(plan, limits), *_gyro_problems(plan, limits)]


def _order_problems(planned: PlannedStep) -> Iterator[DocumentProblem]:
    step, bench = planned.step, planned.before
    if isinstance(step, PowerOn) and bench.powered:
        yield DocumentProblem(planned.location, "the INS is already on here. Put power_off before this step")
    needs_power = isinstance(step, Align | Navigate | Turn | RotatingStep) or (
        isinstance(step, Soak) and step.for_s is None
    )
    if needs_power and not bench.powered:
        yield DocumentProblem(
            planned.location, f"{step.name} needs the INS on. Put power_on before this step"
        )
    if isinstance(step, Align) and bench.position is None:
        yield DocumentProblem(planned.location, "align needs a position. Put go_to before this step")
    if isinstance(step, Navigate | Turn | RotatingStep) and bench.powered and not bench.aligned:
        yield DocumentProblem(
            planned.location,
            f"{step.name} needs an aligned INS. Put align before it, after the last go_to and power_on",
        )


def _command_problems(planned: PlannedStep, limits: StationLimits) -> Iterator[DocumentProblem]:
    command = "align" if isinstance(planned.step, Align) else "navigate"
    is_sent = isinstance(planned.step, Align | Navigate | RotatingStep)
    if is_sent and command not in limits.ins_commands:
        yield DocumentProblem(
            planned.location,
            f"{planned.step.name} sends the INS the command '{command}', which the station lacks. "
            f"Add ins.commands.{command} to the station file",
        )
    needs_temperatures = (
        planned.step.purpose == "calibration"
        if isinstance(planned.step, Navigate)
        else isinstance(planned.step, Soak) and planned.step.for_s is None
    )
    if needs_temperatures and not limits.has_gyro_temperatures:
        yield DocumentProblem(
            planned.location,
            f"{planned.step.name} needs the temperatures of the gyros, which the station lacks. Map "
            "ins.signals.gyro_optics_temperature in the station file; one sensor may serve all gyros",
        )


def _time_problems(planned: PlannedStep) -> Iterator[DocumentProblem]:
    step = planned.step
    min_s = step.at_most_s if isinstance(step, Soak) and step.for_s is None else planned.duration_s
    if planned.timeout_s < min_s:
        yield DocumentProblem(
            planned.place_of("timeout_s"),
            f"timeout_s ({planned.timeout_s:g} s) is shorter than the step, which takes {min_s:.0f} s",
        )


def _chamber_problems(planned: PlannedStep, limits: StationLimits) -> Iterator[DocumentProblem]:
    step = planned.step
    if not isinstance(step, SetChamber):
        return
    if not limits.chamber_low_c <= step.temperature_c <= limits.chamber_high_c:
        yield DocumentProblem(
            planned.place_of("temperature_c"),
            f"{step.temperature_c:g} degC is outside the chamber's range of "
            f"{limits.chamber_low_c:g} to {limits.chamber_high_c:g} degC",
        )
    if step.ramp_c_per_min > limits.ramp_max_c_per_min:
        yield DocumentProblem(
            planned.place_of("ramp_c_per_min"),
            f"a ramp of {step.ramp_c_per_min:g} degC/min is too fast for the chamber; "
            f"allowed: at most {limits.ramp_max_c_per_min:g} degC/min",
        )


def _gyro_problems(plan: Plan, limits: StationLimits) -> Iterator[DocumentProblem]:
    """Problems of chamber set points that would bring the gyros to a trip limit of their interlock."""
    place: KeyPath | None = None
    reported = set()  # a place in a loop is reported once
    for planned in plan.steps:
        if isinstance(planned.step, SetChamber):
            place = planned.place_of("temperature_c")
        gyro_c = planned.after.gyro_c
        is_safe = limits.gyro_low_c <= gyro_c <= limits.gyro_high_c
        if place is not None and place not in reported and not is_safe:
            reported.add(place)
            yield DocumentProblem(
                place,
                f"the gyros would reach {gyro_c:.0f} degC; the interlock gyro_temperature trips outside "
                f"{limits.gyro_low_c:g} to {limits.gyro_high_c:g} degC",
            )


def _table_problems(planned: PlannedStep, limits: StationLimits) -> Iterator[DocumentProblem]:
    step, key = planned.step, "rates_dps" if isinstance(planned.step, Spin) else "rate_dps"
    if isinstance(step, GoTo | Turn):
        fastest_dps = step.rate_dps
    elif isinstance(step, RotatingStep):
        fastest_dps = max(rate_dps for _, rate_dps in step.moves())
    else:
        return
    if fastest_dps > limits.table_rate_max_dps:
        yield DocumentProblem(
            planned.place_of(key),
            f"a rate of {fastest_dps:g} deg/s is too fast for the table; "
            f"allowed: at most {limits.table_rate_max_dps:g} deg/s",
        )


def _test_problems(plan: Plan, limits: StationLimits) -> Iterator[DocumentProblem]:
    tests = plan.procedure.tests
    for name in ("turn_on_repeatability", "warm_up"):
        if limits.is_always_on and getattr(tests, name):
            yield DocumentProblem(
                ("tests", name),
                "the test needs an INS that is switched off and on; that of the station stays on "
                "(unit.power: always_on)",
            )
    if tests.turn_on_repeatability:
        required = tests.turn_on_repeatability.min_power_cycles
        power_ons = itertools.accumulate(isinstance(each.step, PowerOn) for each in plan.steps)
        power_cycles = {number for number, each in zip(power_ons, plan.steps, strict=True) if each.dwell}
        if len(power_cycles) < required:
            yield DocumentProblem(
                ("tests", "turn_on_repeatability"),
                f"the plan has dwells in {len(power_cycles)} power cycles; the test needs {required}. Repeat "
                "power_on, a dwell and power_off",
            )
    spins = tests.scale_factor_stability
    spin_dwells = {each.dwell for each in plan.steps if isinstance(each.step, Spin)}
    if spins and len(spin_dwells) < spins.min_measurements:
        yield DocumentProblem(
            ("tests", "scale_factor_stability"),
            f"the plan has {len(spin_dwells)} dwells with step spin; the test needs {spins.min_measurements}."
            " Repeat go_to, align and spin",
        )


_NAMES = {"calibration_check": "calibration check", "noise": "noise record"}
_INSEPARABLE = "biases and initial errors can't be separated"


def _dwell_problems(plan: Plan) -> Iterator[DocumentProblem]:
    """Problems of dwells that would give no result, in no particular order."""
    for dwell, steps in itertools.groupby(plan.steps, key=lambda planned: planned.dwell):
        group = list(steps)
        windows = [planned for planned in group if isinstance(planned.step, Navigate)]
        yield from itertools.chain.from_iterable(map(_navigation_time_problems, windows))
        if dwell is None:
            yield from _stray_navigation_problems(windows)
            continue
        if group[0].purpose is DwellPurpose.ROTATIONS:
            yield from _mixed_rotation_problems(group)
            continue
        turns = [planned for planned in group if isinstance(planned.step, Turn)]
        is_single = group[0].purpose in SINGLE_NAVIGATION
        window_problems = _turned_check_problems if is_single else _one_sided_problems
        yield from window_problems(windows, [*turns, *_turn_after(plan, group[-1])])
        yield from _until_problems(windows)
        yield from _successive_navigation_problems(group)
        yield from _same_azimuth_problems(windows, turns)
    yield from _unpaired_check_problems(plan)


def _navigation_time_problems(window: PlannedStep) -> Iterator[DocumentProblem]:
    step = window.step
    if not isinstance(step, Navigate):
        return
    key, min_s = ("at_least_s", step.at_least_s) if step.until else ("duration_s", step.max_duration_s)
    if min_s < MIN_NAVIGATION_S:
        yield DocumentProblem(
            window.place_of(key),
            f"navigate for {min_s:g} s is too short for a bias; allowed: {MIN_NAVIGATION_S:g} s or more",
        )


def _stray_navigation_problems(windows: Sequence[PlannedStep]) -> Iterator[DocumentProblem]:
    for window in windows:
        if window.before.aligned:  # otherwise the missing alignment is reported
            yield DocumentProblem(
                window.location,
                "this navigation belongs to no dwell: only navigate, turn and wait may follow align",
            )


def _mixed_rotation_problems(dwell: Sequence[PlannedStep]) -> Iterator[DocumentProblem]:
    for planned in dwell:
        if isinstance(planned.step, Navigate | Turn):
            yield DocumentProblem(
                planned.location,
                f"{planned.step.name} has no place beside rotate and spin, which have rests themselves. Put "
                "go_to and align between them",
            )


def _turn_after(plan: Plan, last: PlannedStep) -> list[PlannedStep]:
    """The turn that follows the last navigation of a dwell, outside the dwell, in a list; empty if none."""
    following = itertools.dropwhile(lambda planned: isinstance(planned.step, Wait), plan.steps_after(last))
    return [planned for planned in itertools.islice(following, 1) if isinstance(planned.step, Turn)]


def _turned_check_problems(
    windows: Sequence[PlannedStep], turns: Sequence[PlannedStep]
) -> Iterator[DocumentProblem]:
    if not turns:
        return
    for window in windows:
        if isinstance(window.step, Navigate) and window.step.purpose != "calibration":
            yield DocumentProblem(
                window.place_of("purpose"),
                f"a {_NAMES[window.step.purpose]} is one navigation directly after the alignment, without a "
                "turn before or after it. Leave purpose out, or replace the turn by go_to and align",
            )


def _one_sided_problems(
    windows: Sequence[PlannedStep], turns: Sequence[PlannedStep]
) -> Iterator[DocumentProblem]:
    if len(windows) != 1:
        return
    if turns:
        message = (
            f"navigation on one side of the turn only: {_INSEPARABLE}. Navigate before and after the turn"
        )
    else:
        message = (
            f"no turn: {_INSEPARABLE}. Add a turn and a second navigation, or set purpose: calibration_check"
        )
    yield DocumentProblem(windows[0].location, message)


def _until_problems(windows: Sequence[PlannedStep]) -> Iterator[DocumentProblem]:
    first = windows[0]
    if isinstance(first.step, Navigate) and first.step.until:
        yield DocumentProblem(
            first.place_of("until"),
            f"until needs a navigation and a turn before it; without them {_INSEPARABLE}. Use duration_s",
        )


def _successive_navigation_problems(dwell: Sequence[PlannedStep]) -> Iterator[DocumentProblem]:
    moves = [planned for planned in dwell if isinstance(planned.step, Navigate | Turn)]
    advice = _turn_advice(moves)
    for earlier, later in itertools.pairwise(moves):
        if isinstance(earlier.step, Navigate) and isinstance(later.step, Navigate):
            yield DocumentProblem(later.location, f"two navigations in succession{advice}")


def _turn_advice(moves: Sequence[PlannedStep]) -> str:
    """Advice for two navigations in succession; a single one gives a bias only in a calibration check."""
    if moves[0].purpose in SINGLE_NAVIGATION:
        name = _NAMES[moves[0].purpose]
        return f": a {name} has a single one. Make it longer, or put go_to and align between them"
    has_turn = any(isinstance(planned.step, Turn) for planned in moves)
    return ". Put a turn between them" + (", or make one longer" if has_turn else "")


def _same_azimuth_problems(
    windows: Sequence[PlannedStep], turns: Sequence[PlannedStep]
) -> Iterator[DocumentProblem]:
    azimuths_deg = {round(window.before.azimuth_deg, 6) % 360.0 for window in windows}
    if turns and len(windows) > 1 and len(azimuths_deg) == 1:
        yield DocumentProblem(
            turns[-1].place_of("angle_deg"),
            f"all navigations are at azimuth {azimuths_deg.pop():g} deg: {_INSEPARABLE}. "
            "Turn by an angle other than a full circle",
        )


def _unpaired_check_problems(plan: Plan) -> Iterator[DocumentProblem]:
    """Problems of checks without a partner half a turn away, at the same position and temperature.

    A gyro bias changes the two headings in opposite directions, an azimuth error of the table in the same.
    """
    groups: dict[tuple[int, int, str | None], list[PlannedStep]] = defaultdict(list)
    plateaus = itertools.groupby(
        plan.steps, lambda planned: (planned.before.powered, planned.before.set_point_c)
    )
    for number, (_, plateau) in enumerate(plateaus):
        for window in _check_navigations(list(plateau)):
            groups[number, window.cycle, window.before.position].append(window)
    for windows in groups.values():
        for check, partner in half_turn_pairs(windows, lambda window: window.before.azimuth_deg):
            if partner is not None:
                continue
            opposite_deg = (check.before.azimuth_deg + 180.0) % 360.0
            yield DocumentProblem(
                check.place_of("purpose"),
                "a single alignment includes the table's azimuth error. "
                f"Add the same position ({check.before.position}) at azimuth {opposite_deg:g} deg, "
                "in the same cycle, before the next chamber or power step",
            )


def _check_navigations(steps: Sequence[PlannedStep]) -> Iterator[PlannedStep]:
    """Navigations of check dwells; check dwells with turns or several navigations are reported elsewhere."""
    for dwell, members in itertools.groupby(steps, key=lambda planned: planned.dwell):
        group = list(members)
        windows = [planned for planned in group if isinstance(planned.step, Navigate)]
        has_turn = any(isinstance(planned.step, Turn) for planned in group)
        is_check = dwell is not None and group[0].purpose is DwellPurpose.CALIBRATION_CHECK
        if is_check and len(windows) == 1 and not has_turn:
            yield windows[0]


#: Azimuths to try for advice.
_AZIMUTHS_DEG = (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0)


def _reach_problems(plan: Plan, planned: PlannedStep, limits: StationLimits) -> Iterator[DocumentProblem]:
    """Problem of a go_to whose position can't be reached, or not with the turns that follow it.

    It is placed at the first turn that leads out of reach, or at the go_to if its position is out of reach.
    """
    step = planned.step
    if not isinstance(step, GoTo):
        return
    turns = turns_after(plan, planned)
    turns_deg = tuple(each for _, each in turns)
    if limits.unreachable_reason(step.position, step.azimuth_deg, turns_deg) is None:
        return
    for count in range(len(turns_deg) + 1):
        reason = limits.unreachable_reason(step.position, step.azimuth_deg, turns_deg[:count])
        if reason:
            route = f"azimuth {step.azimuth_deg:g}"
            is_azimuth_wrong = "azimuth_deg" in step.model_fields_set and _reachable_azimuths_deg(
                step.position, limits
            )
            place = planned.place_of("azimuth_deg" if is_azimuth_wrong else "position")
            if count:
                route += f", then turns of {', '.join(map(turn_text, turns_deg[:count]))}"
                last = turns[count - 1][0]
                place = last.place_of("angle_deg") if isinstance(last.step, Turn) else last.location
            advice = _reach_advice(step, turns_deg, limits)
            yield DocumentProblem(place, f"{step.position} at {route} deg can't be reached: {reason}{advice}")
            return


def _reach_advice(step: GoTo, turns_deg: tuple[TurnOrMove, ...], limits: StationLimits) -> str:
    azimuths_deg = _reachable_azimuths_deg(step.position, limits)
    positions = [
        name for name in POSITIONS if limits.unreachable_reason(name, step.azimuth_deg, turns_deg) is None
    ]
    advice = ""
    if 0 < len(azimuths_deg) < len(_AZIMUTHS_DEG):
        azimuths = ", ".join(f"{azimuth:g}" for azimuth in azimuths_deg)
        advice += f". In {step.position} the table reaches azimuth {azimuths} deg"
    if positions and (turns_deg or step.azimuth_deg):
        advice += f". This azimuth with its turns can be reached in {', '.join(positions)}"
    return advice


def _reachable_azimuths_deg(position: str, limits: StationLimits) -> list[float]:
    return [each for each in _AZIMUTHS_DEG if limits.unreachable_reason(position, each, ()) is None]
