"""A plan over time: rows of a table, temperatures and positions."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.procedure.steps import Align, GoTo, Soak, span

#: Name in place of a position while the table rotates.
ROTATIONS = "rotations"
_INTERVAL_S = 60.0
_MAX_SAMPLES = 200


@dataclass(frozen=True)
class TimelineRow:
    """Steps of one plateau: those on the way to it, or those in its positions."""

    start_s: float
    duration_s: float
    steps_text: str  #: Each different step once, with its count per dwell.
    positions_text: str  #: Cycle, temperature and positions in order, with azimuths other than 0.
    dwells: int


def timeline_rows(plan: Plan) -> list[TimelineRow]:
    """Two rows for each plateau: one for the way to it, one for all its positions."""
    groups = itertools.groupby(plan.steps, lambda planned: (planned.plateau, planned.in_position))
    return [_row(list(group)) for _, group in groups]


def unsettled_soaks(plan: Plan) -> list[str]:
    """Describe the soaks that are expected to end by their time limit before the gyros have settled."""
    return [
        f"{planned.plateau or 'room'}: {planned.after.settling_c_per_h:.2g} degC/h after "
        f"{span(step.at_most_s)}, limit {limit_c_per_h:g} degC/h"
        for planned in plan.steps
        if isinstance(step := planned.step, Soak)
        and (limit_c_per_h := step.until_gyro_rate_below_c_per_h) is not None
        and planned.before.time_until_gyro_rate_s(limit_c_per_h) > step.at_most_s
    ]


def is_cycle_unnumbered(plan: Plan) -> bool:
    """Whether all temperatures and positions are repeated, and all in one cycle.

    A profile up and down in one cycle repeats all but its ends.
    """
    dwells = [
        each
        for each in plan.steps
        if each.dwell and isinstance(each.step, Align) and each.purpose is DwellPurpose.CALIBRATION
    ]
    conditions = [(each.before.set_point_c, each.before.position, each.before.azimuth_deg) for each in dwells]
    plateaus = itertools.groupby(conditions, key=lambda condition: condition[0])
    visits = Counter(condition for _, plateau in plateaus for condition in {*plateau})
    return len({each.cycle for each in dwells}) == 1 and min(visits.values()) > 1


def temperature_profile(plan: Plan) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Predict the temperatures over a plan.

    Returns time_s, chamber_c, gyro_c: time from the start of the plan every minute (wider in very long
    steps) and twice at the borders of steps, the chamber's ramped set point, and the predicted
    temperature of the gyros.
    """
    rows = [row for planned in plan.steps for row in _samples(planned)]
    time_s, chamber_c, gyro_c = np.array(rows).T
    return time_s, chamber_c, gyro_c


def position_spans(plan: Plan) -> list[tuple[float, float, str]]:
    """Start, end and name of each visit to a position, from its go_to to the last step that belongs to it.

    A visit with rotations, which leave the position, has the name :data:`ROTATIONS`.
    """
    visit_numbers = itertools.accumulate(int(isinstance(planned.step, GoTo)) for planned in plan.steps)
    in_position = [pair for pair in zip(visit_numbers, plan.steps, strict=True) if pair[1].in_position]
    spans = []
    for _, pairs in itertools.groupby(in_position, key=lambda pair: pair[0]):
        visit = [planned for _, planned in pairs]
        position = visit[0].after.position
        if position is not None:
            is_rotated = any(planned.purpose is DwellPurpose.ROTATIONS for planned in visit)
            spans.append((visit[0].start_s, visit[-1].end_s, ROTATIONS if is_rotated else position))
    return spans


def _row(group: Sequence[PlannedStep]) -> TimelineRow:
    first, last = group[0], group[-1]
    moves = [planned.step for planned in group if isinstance(planned.step, GoTo)]
    others = [planned for planned in group if not isinstance(planned.step, GoTo)]
    positions_text = [first.plateau, *_position_texts(moves)]
    return TimelineRow(
        start_s=first.start_s,
        duration_s=last.end_s - first.start_s,
        steps_text="; ".join(_distinct_steps(others or group)),
        positions_text=", ".join(part for part in positions_text if part),
        dwells=len({planned.dwell for planned in group} - {None}),
    )


def _distinct_steps(group: Sequence[PlannedStep]) -> Iterator[str]:
    """Each different step once, with its largest count in a dwell."""
    max_counts: dict[str, int] = {}
    for (dwell, description), count in Counter((each.dwell, each.step.describe()) for each in group).items():
        max_counts[description] = max(max_counts.get(description, 1), count if dwell else 1)
    for description, count in max_counts.items():
        yield f"{count} x {description}" if count > 1 else description


def _position_texts(moves: Sequence[GoTo]) -> Iterator[str]:
    """Each position once for all visits in succession: "z_up, y_up 0/180 deg"."""
    for position, visits in itertools.groupby(moves, key=lambda move: move.position):
        azimuths_deg = dict.fromkeys(visit.azimuth_deg for visit in visits)
        azimuths = "/".join(f"{azimuth:g}" for azimuth in azimuths_deg)
        yield position if azimuths == "0" else f"{position} {azimuths} deg"


def _samples(planned: PlannedStep) -> list[tuple[float, float, float]]:
    count = min(1 + math.ceil(planned.duration_s / _INTERVAL_S), _MAX_SAMPLES)
    samples = []
    for elapsed_s in np.linspace(0.0, planned.duration_s, count):
        bench = planned.step.after(planned.before, float(elapsed_s))
        samples.append((planned.start_s + float(elapsed_s), bench.chamber_c, bench.gyro_c))
    return samples
