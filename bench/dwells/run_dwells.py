"""The dwells of a run, collected as they are measured: what several show together flags each of them.

A run of a thousand hours has thousands of dwells. Their rows and what the joint solution needs are small; the
navigation for the noise estimate is kept of some dwells only, evenly spread over the run.
"""

from __future__ import annotations

from dataclasses import replace

from gyrobench.bench.bias.damping import Damping
from gyrobench.bench.dwells.measure_dwell import MeasuredDwell
from gyrobench.bench.dwells.setup_check import setup_fault
from gyrobench.bench.dwells.temperatures import stuck_sensors

#: The noise estimate does not improve with more dwells than this.
_MAX_WITH_NAVIGATION = 128


def add_dwell(dwells: list[MeasuredDwell], measured: MeasuredDwell) -> None:
    """Add the next dwell of a run.

    A temperature sensor that turns out to be stuck flags the dwells since it is, earlier ones too.
    """
    dwells.append(measured)
    for index, flag in stuck_sensors([each.row for each in dwells]):
        if flag not in dwells[index].flags:
            dwells[index] = dwells[index].flagged(flag)
    _flag_damping(dwells)
    _flag_setup(dwells)
    _keep_navigation_of_some(dwells)


#: The velocity of an INS is damped where the rate of all dwells together has less than this probability.
_MIN_DAMPING_P_VALUE = 1e-5


def _flag_damping(dwells: list[MeasuredDwell]) -> None:
    """Flag all dwells of an INS that damps its velocity: few dwells show it by themselves."""
    known = [each for each in dwells if each.estimate and not each.is_disturbed]
    # By the tilt, and where the attitude is too coarse for that, by the error model alone.
    by_tilt = [each.evidence.velocities.damping for each in known if each.evidence]
    by_model = [each.estimate.damping for each in known if each.estimate]
    found = [Damping.mean(each) for each in (by_tilt, by_model) if each]
    damping = next((each for each in found if each.shows(_MIN_DAMPING_P_VALUE)), None)
    if damping is None:
        return
    for index, dwell in enumerate(dwells):
        if dwell.estimate and not any(flag.startswith(Damping.FLAG) for flag in dwell.flags):
            persistent = (*dwell.persistent_flags, damping.text)
            dwells[index] = replace(dwell.flagged(damping.text), persistent_flags=persistent)


def _flag_setup(dwells: list[MeasuredDwell]) -> None:
    """Flag all dwells of a set-up that they contradict together."""
    fault = setup_fault([each.evidence for each in dwells if each.evidence])
    if not fault:
        return
    for index, dwell in enumerate(dwells):
        if not dwell.setup_fault:
            dwells[index] = replace(dwell.flagged(fault), setup_fault=fault)


def _keep_navigation_of_some(dwells: list[MeasuredDwell]) -> None:
    spacing, last = _spacing(len(dwells)), len(dwells) - 1
    first = 0 if spacing != _spacing(last) else last
    for index in range(first, len(dwells)):
        if index % spacing and dwells[index].windows:
            dwells[index] = replace(dwells[index], windows=())


def _spacing(count: int) -> int:
    """Smallest power of two that leaves few enough."""
    return 1 << max(0, (max(count, 1) - 1) // _MAX_WITH_NAVIGATION).bit_length()
