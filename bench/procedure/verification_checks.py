"""What can't verify a calibration in a plan: alignments without one half a turn from them."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterator, Sequence

from gyrobench.bench.foundations.documents import Problem
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.procedure.steps import Navigate, Turn

_TOLERANCE_DEG = 0.5


def find_unpaired_verifications(plan: Plan) -> Iterator[Problem]:
    """Verifications that have no partner half a turn away, in their position and at their temperature.

    A gyro bias turns the heading of one alignment against the other; an error of the table's
    azimuth turns both alike.
    """
    groups: dict[tuple[int, int, str | None], list[PlannedStep]] = defaultdict(list)
    for number, stop in enumerate(_stops(plan)):
        for window in _verifying(stop):
            groups[number, window.cycle, window.before.position].append(window)
    for windows in groups.values():
        for alone in _without_partner(windows):
            opposite_deg = (alone.before.azimuth_deg + 180.0) % 360.0
            yield Problem(
                alone.place_of("purpose"),
                "a single alignment shows the table's own azimuth error too: "
                f"add the same position ({alone.before.position}) at azimuth {opposite_deg:g} deg, "
                "in the same cycle, before the next chamber or power step",
            )


def _stops(plan: Plan) -> Iterator[list[PlannedStep]]:
    """Cut a plan where the set point of the chamber changes, or the power."""
    for _, steps in itertools.groupby(
        plan.steps, key=lambda planned: (planned.before.powered, planned.before.set_point_c)
    ):
        yield list(steps)


def _verifying(steps: Sequence[PlannedStep]) -> Iterator[PlannedStep]:
    """Navigations of verification dwells; those with several or with turns are another problem."""
    for dwell, members in itertools.groupby(steps, key=lambda planned: planned.dwell):
        group = list(members)
        windows = [planned for planned in group if isinstance(planned.step, Navigate)]
        turned = any(isinstance(planned.step, Turn) for planned in group)
        if dwell is not None and group[0].is_verification and len(windows) == 1 and not turned:
            yield windows[0]


def _without_partner(windows: Sequence[PlannedStep]) -> list[PlannedStep]:
    """Pair each with the first that waits half a turn away, as the measurement does."""
    waiting: list[PlannedStep] = []
    for window in windows:
        partner = next((other for other in waiting if _half_turn_apart(other, window)), None)
        if partner is None:
            waiting.append(window)
        else:
            waiting.remove(partner)
    return waiting


def _half_turn_apart(one: PlannedStep, other: PlannedStep) -> bool:
    away_deg = (other.before.azimuth_deg - one.before.azimuth_deg) % 360.0 - 180.0
    return abs(away_deg) < _TOLERANCE_DEG
