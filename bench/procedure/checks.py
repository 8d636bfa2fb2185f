"""What can't work in a plan, found before anything moves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

from gyrobench.bench.foundations.documents import Document, Problem
from gyrobench.bench.procedure.climate_steps import Chamber, Soak
from gyrobench.bench.procedure.dwell_checks import find_dwell_problems
from gyrobench.bench.procedure.limits import StationLimits
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.procedure.reach import find_reach_problems
from gyrobench.bench.procedure.steps import Align, GoTo, Navigate, PowerOn, Turn


def check(document: Document, plan: Plan, limits: StationLimits | None = None) -> None:
    """Refuse a plan that can't be run.

    Parameters
    ----------
    document : Document
        File that the plan came from.
    plan : Plan
        Plan to look at.
    limits : StationLimits, optional
        Limits of the station that is to run it; without them only the order of the steps and
        their times are checked.

    Raises
    ------
    DocumentError
        Lists everything that is wrong, each with its place in the file.
    """
    problems = find_problems(plan, limits)
    if problems:
        raise document.error(problems)


def find_problems(plan: Plan, limits: StationLimits | None = None) -> list[Problem]:
    """Everything in a plan that can't work; see :func:`check`."""
    if limits is not None:  # a long plan asks for the same few attitudes again and again
        limits = replace(limits, reachable=cache(limits.reachable))
    problems = [*find_dwell_problems(plan)]
    for planned in plan.steps:
        problems += [*_order_problems(planned), *_time_problems(planned)]
        if limits is not None:
            problems += [*_chamber_problems(planned, limits), *_table_problems(planned, limits)]
            problems += find_reach_problems(plan, planned, limits)
    if limits is not None:
        problems += _gyro_problems(plan, limits)
    return problems


def _order_problems(planned: PlannedStep) -> Iterator[Problem]:
    step, bench = planned.step, planned.before
    if isinstance(step, PowerOn) and bench.powered:
        yield Problem(planned.location, "the INS is already on here; power_off must come before")
    needs_power = isinstance(step, Align | Navigate) or (isinstance(step, Soak) and step.for_s is None)
    if needs_power and not bench.powered:
        yield Problem(planned.location, f"{step.name} needs the INS: power_on must come before")
    if isinstance(step, Align) and bench.position is None:
        yield Problem(planned.location, "align needs a position: go_to must come before")
    if isinstance(step, Navigate | Turn) and not bench.aligned:
        yield Problem(
            planned.location,
            f"{step.name} needs an aligned INS: align must come before, after the last go_to and power_on",
        )


def _time_problems(planned: PlannedStep) -> Iterator[Problem]:
    step = planned.step
    least_s = step.at_most_s if isinstance(step, Soak) and step.for_s is None else planned.duration_s
    if planned.timeout_s < least_s:
        yield Problem(
            planned.place_of("timeout_s"),
            f"timeout_s of {planned.timeout_s:g} s ends the step before its {least_s:.0f} s are over",
        )


def _chamber_problems(planned: PlannedStep, limits: StationLimits) -> Iterator[Problem]:
    step = planned.step
    if not isinstance(step, Chamber):
        return
    if not limits.chamber_low_c <= step.temperature_c <= limits.chamber_high_c:
        yield Problem(
            planned.place_of("temperature_c"),
            f"{step.temperature_c:g} degC is outside the chamber's range of "
            f"{limits.chamber_low_c:g} to {limits.chamber_high_c:g} degC",
        )
    if step.ramp_c_per_min > limits.ramp_max_c_per_min:
        yield Problem(
            planned.place_of("ramp_c_per_min"),
            f"a ramp of {step.ramp_c_per_min:g} degC/min is too fast for the chamber; "
            f"at most {limits.ramp_max_c_per_min:g} degC/min",
        )


def _gyro_problems(plan: Plan, limits: StationLimits) -> Iterator[Problem]:
    """Tell where a chamber's command would bring the gyros to where an interlock trips."""
    command: PlannedStep | None = None
    for planned in plan.steps:
        if isinstance(planned.step, Chamber):
            command = planned
        gyro_c = planned.after.gyro_c
        if command is not None and not limits.gyro_low_c <= gyro_c <= limits.gyro_high_c:
            yield Problem(
                command.place_of("temperature_c"),
                f"the gyros would come to {gyro_c:.0f} degC, where the interlock gyro_temperature trips "
                f"({limits.gyro_low_c:g} to {limits.gyro_high_c:g} degC)",
            )
            command = None


def _table_problems(planned: PlannedStep, limits: StationLimits) -> Iterator[Problem]:
    step = planned.step
    if isinstance(step, GoTo | Turn) and step.rate_dps > limits.table_rate_max_dps:
        yield Problem(
            planned.place_of("rate_dps"),
            f"a rate of {step.rate_dps:g} deg/s is too fast for the table; "
            f"at most {limits.table_rate_max_dps:g} deg/s",
        )
