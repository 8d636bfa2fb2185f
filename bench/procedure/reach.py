"""Whether a table can stand in the positions of a plan and do the turns there."""

from __future__ import annotations

from collections.abc import Iterator

from gyrobench.bench.foundations.documents import Location, Problem
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.limits import StationLimits
from gyrobench.bench.procedure.plan import Plan, PlannedStep, turn_steps_after
from gyrobench.bench.procedure.steps import GoTo, Turn

#: Azimuths to try for advice.
_AZIMUTHS_DEG = (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0)


def find_reach_problems(plan: Plan, planned: PlannedStep, limits: StationLimits) -> Iterator[Problem]:
    """Tell why a position can't be taken, or not with the turns that follow there.

    Parameters
    ----------
    plan : Plan
        Plan to look at.
    planned : PlannedStep
        One of its steps; only a go_to can have a problem.
    limits : StationLimits
        What the table reaches.

    Yields
    ------
    Problem
        At the first turn that leads out of reach, or at the go_to where no turn is to blame.
    """
    step = planned.step
    if not isinstance(step, GoTo):
        return
    turn_steps = turn_steps_after(plan, planned)
    turns_deg = tuple(turn.step.angle_deg for turn in turn_steps if isinstance(turn.step, Turn))
    if limits.reachable(step.position, step.azimuth_deg, turns_deg) is None:
        return
    for count in range(len(turns_deg) + 1):
        reason = limits.reachable(step.position, step.azimuth_deg, turns_deg[:count])
        if reason:
            what = ", then turns of ".join([f"azimuth {step.azimuth_deg:g}", *_listed(turns_deg[:count])])
            yield Problem(
                turn_steps[count - 1].place_of("angle_deg") if count else _place(planned, step, limits),
                f"{step.position} at {what} deg can't be reached: {reason}{_advice(step, turns_deg, limits)}",
            )
            return


def _place(planned: PlannedStep, step: GoTo, limits: StationLimits) -> Location:
    another_would_do = "azimuth_deg" in step.model_fields_set and _azimuths_deg(step.position, limits)
    return planned.place_of("azimuth_deg" if another_would_do else "position")


def _advice(step: GoTo, turns_deg: tuple[float, ...], limits: StationLimits) -> str:
    azimuths_deg = _azimuths_deg(step.position, limits)
    positions = [name for name in POSITIONS if limits.reachable(name, step.azimuth_deg, turns_deg) is None]
    advice = ""
    if 0 < len(azimuths_deg) < len(_AZIMUTHS_DEG):
        azimuths = ", ".join(f"{azimuth:g}" for azimuth in azimuths_deg)
        advice += f". In {step.position} the table can stand at azimuth {azimuths} deg"
    if positions and (turns_deg or step.azimuth_deg):
        advice += f". This azimuth with its turns can be reached in {', '.join(positions)}"
    return advice


def _azimuths_deg(position: str, limits: StationLimits) -> list[float]:
    return [each for each in _AZIMUTHS_DEG if limits.reachable(position, each, ()) is None]


def _listed(turns_deg: tuple[float, ...]) -> list[str]:
    return [", ".join(f"{turn:g}" for turn in turns_deg)] if turns_deg else []
