"""What can't work in a plan, found before anything moves."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

from gyrobench.bench.foundations.documents import Document, DocumentProblem, KeyPath
from gyrobench.bench.navigation.positions import POSITIONS, half_turn_pairs
from gyrobench.bench.navigation.table_axes import TurnOrMove, turn_text
from gyrobench.bench.procedure.plan import (
    SINGLE_NAVIGATION,
    DwellPurpose,
    Plan,
    PlannedStep,
    turn_steps_after,
    turns_of,
)
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
    """Limits of one station's chamber and table."""

    #: chamber_low_c, chamber_high_c: Range of the chamber's set point.
    chamber_low_c: float
    chamber_high_c: float
    ramp_max_c_per_min: float  #: Fastest ramp of the chamber, up or down.
    table_rate_max_dps: float  #: Fastest turn of either axis of the table.
    #: ``reachable(position, azimuth_deg, turns_deg)`` gives the reason why the table can't go there and then
    #: do these turns; None if it can.
    reachable: Callable[[str, float, tuple[TurnOrMove, ...]], str | None]
    #: gyro_low_c, gyro_high_c: Temperatures of the gyros at which an interlock trips.
    gyro_low_c: float = -math.inf
    gyro_high_c: float = math.inf
    #: Commands that the INS of the station has.
    ins_commands: frozenset[str] = frozenset({"align", "navigate"})


def check_plan(document: Document, plan: Plan, limits: StationLimits | None = None) -> None:
    """Refuse a plan that can't be run: a DocumentError lists all problems with their places in the file.

    Without the limits of a station only the order of the steps and their times are checked.
    """
    problems = find_problems(plan, limits)
    if problems:
        raise document.error(problems)


def find_problems(plan: Plan, limits: StationLimits | None = None) -> list[DocumentProblem]:
    """All problems of a plan; see :func:`check_plan`."""
    if limits is not None:  # a long plan asks for the same few attitudes again and again
        limits = replace(limits, reachable=cache(limits.reachable))
    problems = [*_find_dwell_problems(plan)]
    for planned in plan.steps:
        problems += [*_order_problems(planned), *_time_problems(planned)]
        if limits is not None:
            problems += [*_chamber_problems(planned, limits), *_table_problems(planned, limits)]
            problems += _command_problems(planned, limits)
            problems += _find_reach_problems(plan, planned, limits)
    problems += [*_test_problems(plan), *_spin_problems(plan)]
    if limits is not None:
        problems += _gyro_problems(plan, limits)
    return problems


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
    """Commands of the chamber that would bring the gyros to a temperature at which an interlock trips."""
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


def _test_problems(plan: Plan) -> Iterator[DocumentProblem]:
    tests = plan.procedure.tests
    if tests.turn_on_repeatability:
        least = tests.turn_on_repeatability.min_power_cycles
        power_ons = itertools.accumulate(isinstance(each.step, PowerOn) for each in plan.steps)
        cycles = {number for number, each in zip(power_ons, plan.steps, strict=True) if each.dwell}
        if len(cycles) < least:
            yield DocumentProblem(
                ("tests", "turn_on_repeatability"),
                f"the plan has dwells in {len(cycles)} power cycles; the test needs {least}. Repeat "
                "power_on, a dwell and power_off",
            )


def _spin_problems(plan: Plan) -> Iterator[DocumentProblem]:
    test = plan.procedure.tests.scale_factor_stability
    spun = {each.dwell for each in plan.steps if isinstance(each.step, Spin)}
    if test and len(spun) < test.min_measurements:
        yield DocumentProblem(
            ("tests", "scale_factor_stability"),
            f"the plan has {len(spun)} dwells with step spin; the test needs {test.min_measurements}. Repeat "
            "go_to, align and spin",
        )


_INSEPARABLE = "biases and initial errors can't be separated"


def _find_dwell_problems(plan: Plan) -> Iterator[DocumentProblem]:
    """Everything that keeps the dwells of a plan from giving a result, in no order."""
    for dwell, steps in itertools.groupby(plan.steps, key=lambda planned: planned.dwell):
        group = list(steps)
        windows = [planned for planned in group if isinstance(planned.step, Navigate)]
        yield from itertools.chain.from_iterable(map(_navigation_time_problems, windows))
        if dwell is None:
            yield from _outside_dwells(windows)
            continue
        if group[0].purpose is DwellPurpose.ROTATIONS:
            yield from _mixed_with_rotations(group)
            continue
        turns = [planned for planned in group if isinstance(planned.step, Turn)]
        kind_problems = _turned_check if group[0].purpose in SINGLE_NAVIGATION else _one_sided
        yield from kind_problems(windows, [*turns, *_turn_that_follows(plan, group[-1])])
        yield from _until_without_turn(windows)
        yield from _not_turned_between(group)
        yield from _turned_to_the_same(windows, turns)
    yield from _find_unpaired_checks(plan)


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


def _outside_dwells(windows: Sequence[PlannedStep]) -> Iterator[DocumentProblem]:
    for window in windows:
        if window.before.aligned:  # else that is the problem to report
            yield DocumentProblem(
                window.location,
                "this navigation belongs to no dwell: only navigate, turn and wait may follow align",
            )


def _mixed_with_rotations(dwell: Sequence[PlannedStep]) -> Iterator[DocumentProblem]:
    for planned in dwell:
        if isinstance(planned.step, Navigate | Turn):
            yield DocumentProblem(
                planned.location,
                f"{planned.step.name} has no place beside rotate and spin, which have rests themselves. Put "
                "go_to and align between them",
            )


def _turn_that_follows(plan: Plan, last: PlannedStep) -> list[PlannedStep]:
    """Find a turn after the last navigation, which its dwell does not contain."""
    following = itertools.dropwhile(lambda planned: isinstance(planned.step, Wait), plan.later(last))
    return [planned for planned in itertools.islice(following, 1) if isinstance(planned.step, Turn)]


def _turned_check(windows: Sequence[PlannedStep], turns: Sequence[PlannedStep]) -> Iterator[DocumentProblem]:
    if not turns:
        return
    for window in windows:
        if isinstance(window.step, Navigate) and window.step.purpose != "calibration":
            name = "a calibration check" if window.step.purpose == "calibration_check" else "a noise record"
            yield DocumentProblem(
                window.place_of("purpose"),
                f"{name} is one navigation directly after the alignment, without a turn before "
                "or after it. Leave purpose out, or replace the turn by go_to and align",
            )


def _one_sided(windows: Sequence[PlannedStep], turns: Sequence[PlannedStep]) -> Iterator[DocumentProblem]:
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


def _until_without_turn(windows: Sequence[PlannedStep]) -> Iterator[DocumentProblem]:
    first = windows[0]
    if isinstance(first.step, Navigate) and first.step.until:
        yield DocumentProblem(
            first.place_of("until"),
            f"until needs a navigation and a turn before it; without them {_INSEPARABLE}. Use duration_s",
        )


def _not_turned_between(dwell: Sequence[PlannedStep]) -> Iterator[DocumentProblem]:
    moves = [planned for planned in dwell if isinstance(planned.step, Navigate | Turn)]
    advice = _turn_advice(moves)
    for earlier, later in itertools.pairwise(moves):
        if isinstance(earlier.step, Navigate) and isinstance(later.step, Navigate):
            yield DocumentProblem(later.location, f"two navigations in succession{advice}")


def _turn_advice(moves: Sequence[PlannedStep]) -> str:
    """What to do about two navigations in succession: one alone gives a bias only in a calibration check."""
    if moves[0].purpose in SINGLE_NAVIGATION:
        kind = "calibration check" if moves[0].purpose is DwellPurpose.CALIBRATION_CHECK else "noise record"
        return f": a {kind} has a single one. Make it longer, or put go_to and align between them"
    has_turn = any(isinstance(planned.step, Turn) for planned in moves)
    return ". Put a turn between them" + (", or make one longer" if has_turn else "")


def _turned_to_the_same(
    windows: Sequence[PlannedStep], turns: Sequence[PlannedStep]
) -> Iterator[DocumentProblem]:
    azimuths_deg = {round(window.before.azimuth_deg, 6) % 360.0 for window in windows}
    if turns and len(windows) > 1 and len(azimuths_deg) == 1:
        yield DocumentProblem(
            turns[-1].place_of("angle_deg"),
            f"all navigations are at azimuth {azimuths_deg.pop():g} deg: {_INSEPARABLE}. "
            "Turn by an angle other than a full circle",
        )


def _find_unpaired_checks(plan: Plan) -> Iterator[DocumentProblem]:
    """Calibration checks that have no partner half a turn away, in their position and at their temperature.

    A gyro bias changes the two headings oppositely, an azimuth error of the table equally.
    """
    groups: dict[tuple[int, int, str | None], list[PlannedStep]] = defaultdict(list)
    for number, plateau in enumerate(_plateaus(plan)):
        for window in _verifying(plateau):
            groups[number, window.cycle, window.before.position].append(window)
    for windows in groups.values():
        for alone, partner in half_turn_pairs(windows, lambda window: window.before.azimuth_deg):
            if partner is not None:
                continue
            opposite_deg = (alone.before.azimuth_deg + 180.0) % 360.0
            yield DocumentProblem(
                alone.place_of("purpose"),
                "a single alignment includes the table's azimuth error. "
                f"Add the same position ({alone.before.position}) at azimuth {opposite_deg:g} deg, "
                "in the same cycle, before the next chamber or power step",
            )


def _plateaus(plan: Plan) -> Iterator[list[PlannedStep]]:
    """Split a plan where the set point of the chamber or the power changes."""
    for _, steps in itertools.groupby(
        plan.steps, key=lambda planned: (planned.before.powered, planned.before.set_point_c)
    ):
        yield list(steps)


def _verifying(steps: Sequence[PlannedStep]) -> Iterator[PlannedStep]:
    """Navigations of check dwells; those with several or with turns are another problem."""
    for dwell, members in itertools.groupby(steps, key=lambda planned: planned.dwell):
        group = list(members)
        windows = [planned for planned in group if isinstance(planned.step, Navigate)]
        turned = any(isinstance(planned.step, Turn) for planned in group)
        is_check = dwell is not None and group[0].purpose is DwellPurpose.CALIBRATION_CHECK
        if is_check and len(windows) == 1 and not turned:
            yield windows[0]


#: Azimuths to try for advice.
_AZIMUTHS_DEG = (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0)


def _find_reach_problems(
    plan: Plan, planned: PlannedStep, limits: StationLimits
) -> Iterator[DocumentProblem]:
    """Why the position of a go_to can't be reached, or not with the turns that follow there.

    The problem is placed at the first turn that leads out of reach, or at the go_to if that is itself.
    """
    step = planned.step
    if not isinstance(step, GoTo):
        return
    turn_steps = turn_steps_after(plan, planned)
    placed = [(turn, each) for turn in turn_steps for each in turns_of(turn)]
    turns_deg = tuple(each for _, each in placed)
    if limits.reachable(step.position, step.azimuth_deg, turns_deg) is None:
        return
    for count in range(len(turns_deg) + 1):
        reason = limits.reachable(step.position, step.azimuth_deg, turns_deg[:count])
        if reason:
            what = ", then turns of ".join([f"azimuth {step.azimuth_deg:g}", *_listed(turns_deg[:count])])
            advice = _reach_advice(step, turns_deg, limits)
            yield DocumentProblem(
                _turn_place(placed[count - 1][0]) if count else _place(planned, step, limits),
                f"{step.position} at {what} deg can't be reached: {reason}{advice}",
            )
            return


def _turn_place(planned: PlannedStep) -> KeyPath:
    return planned.place_of("angle_deg") if isinstance(planned.step, Turn) else planned.location


def _place(planned: PlannedStep, step: GoTo, limits: StationLimits) -> KeyPath:
    another_would_do = "azimuth_deg" in step.model_fields_set and _azimuths_deg(step.position, limits)
    return planned.place_of("azimuth_deg" if another_would_do else "position")


def _reach_advice(step: GoTo, turns_deg: tuple[TurnOrMove, ...], limits: StationLimits) -> str:
    azimuths_deg = _azimuths_deg(step.position, limits)
    positions = [name for name in POSITIONS if limits.reachable(name, step.azimuth_deg, turns_deg) is None]
    advice = ""
    if 0 < len(azimuths_deg) < len(_AZIMUTHS_DEG):
        azimuths = ", ".join(f"{azimuth:g}" for azimuth in azimuths_deg)
        advice += f". In {step.position} the table reaches azimuth {azimuths} deg"
    if positions and (turns_deg or step.azimuth_deg):
        advice += f". This azimuth with its turns can be reached in {', '.join(positions)}"
    return advice


def _azimuths_deg(position: str, limits: StationLimits) -> list[float]:
    return [each for each in _AZIMUTHS_DEG if limits.reachable(position, each, ()) is None]


def _listed(turns_deg: tuple[TurnOrMove, ...]) -> list[str]:
    return [", ".join(map(turn_text, turns_deg))] if turns_deg else []
