"""What can't give a bias in a plan: navigations that are too short, or lack a turn."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

from gyrobench.bench.foundations.documents import Problem
from gyrobench.bench.procedure.navigation_steps import MIN_NAVIGATION_S, Navigate, Turn
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.procedure.steps import Wait
from gyrobench.bench.procedure.verification_checks import find_unpaired_verifications

_NOT_TOLD = "the biases can't be told from the initial errors"


def find_dwell_problems(plan: Plan) -> Iterator[Problem]:
    """Everything that keeps the dwells of a plan from giving a result, in no order."""
    for dwell, steps in itertools.groupby(plan.steps, key=lambda planned: planned.dwell):
        group = list(steps)
        windows = [planned for planned in group if isinstance(planned.step, Navigate)]
        yield from itertools.chain.from_iterable(map(_time_problems, windows))
        if dwell is None:
            yield from _stray(windows)
            continue
        turns = [planned for planned in group if isinstance(planned.step, Turn)]
        kind_problems = _turned_verification if group[0].is_verification else _one_sided
        yield from kind_problems(windows, [*turns, *_turn_that_follows(plan, group[-1])])
        yield from _early_until(windows)
        yield from _not_turned_between(group)
        yield from _turned_to_the_same(windows, turns)
    yield from find_unpaired_verifications(plan)


def _time_problems(window: PlannedStep) -> Iterator[Problem]:
    step = window.step
    if not isinstance(step, Navigate):
        return
    key, shortest_s = ("at_least_s", step.at_least_s) if step.until else ("duration_s", step.longest_s)
    if shortest_s < MIN_NAVIGATION_S:
        yield Problem(
            window.place_of(key),
            f"navigate for {shortest_s:g} s is too short for a bias; at least {MIN_NAVIGATION_S:g} s",
        )


def _stray(windows: Sequence[PlannedStep]) -> Iterator[Problem]:
    for window in windows:
        if window.before.aligned:  # else that is the problem to tell
            yield Problem(
                window.location,
                "this navigation belongs to no dwell: only navigate, turn and wait may stand after align",
            )


def _turn_that_follows(plan: Plan, last: PlannedStep) -> list[PlannedStep]:
    """Find a turn after the last navigation, which its dwell does not contain."""
    following = itertools.dropwhile(lambda planned: isinstance(planned.step, Wait), plan.later(last))
    return [planned for planned in itertools.islice(following, 1) if isinstance(planned.step, Turn)]


def _turned_verification(windows: Sequence[PlannedStep], turns: Sequence[PlannedStep]) -> Iterator[Problem]:
    if not turns:
        return
    for window in windows:
        if isinstance(window.step, Navigate) and window.step.purpose == "verification":
            yield Problem(
                window.place_of("purpose"),
                "a verification is one navigation straight from the alignment, without a turn before or "
                "after it; leave purpose out, or put go_to and align in the place of the turn",
            )


def _one_sided(windows: Sequence[PlannedStep], turns: Sequence[PlannedStep]) -> Iterator[Problem]:
    if len(windows) != 1:
        return
    if turns:
        message = f"navigation on one side of the turn alone: {_NOT_TOLD}; navigate before and after the turn"
    else:
        message = f"no turn: {_NOT_TOLD}; add a turn and a second navigation, or set purpose: verification"
    yield Problem(windows[0].location, message)


def _early_until(windows: Sequence[PlannedStep]) -> Iterator[Problem]:
    first = windows[0]
    if isinstance(first.step, Navigate) and first.step.until:
        yield Problem(
            first.place_of("until"),
            f"until needs a navigation and a turn before it: without them {_NOT_TOLD}; give duration_s here",
        )


def _not_turned_between(dwell: Sequence[PlannedStep]) -> Iterator[Problem]:
    moves = [planned for planned in dwell if isinstance(planned.step, Navigate | Turn)]
    advice = _advice(moves)
    for earlier, later in itertools.pairwise(moves):
        if isinstance(earlier.step, Navigate) and isinstance(later.step, Navigate):
            yield Problem(later.location, f"two navigations in succession: {advice}")


def _advice(moves: Sequence[PlannedStep]) -> str:
    """What may be meant by two navigations in succession: one alone gives a bias only in a verification."""
    if moves[0].is_verification:
        return "a verification is a single one; make it longer, or put go_to and align between them"
    has_turn = any(isinstance(planned.step, Turn) for planned in moves)
    return "put a turn between them" + (", or make one longer" if has_turn else "")


def _turned_to_the_same(windows: Sequence[PlannedStep], turns: Sequence[PlannedStep]) -> Iterator[Problem]:
    azimuths_deg = {round(window.before.azimuth_deg, 6) % 360.0 for window in windows}
    if turns and len(windows) > 1 and len(azimuths_deg) == 1:
        yield Problem(
            turns[-1].place_of("angle_deg"),
            f"all navigations stand at azimuth {azimuths_deg.pop():g} deg: {_NOT_TOLD}; "
            "turn by another angle than full circles",
        )
