"""What the emulated bench is doing, told from the world's own state."""

from __future__ import annotations

from gyrobench.drivers.emulators.faults.timing import Phase
from gyrobench.drivers.emulators.world.inertial_unit import Mode
from gyrobench.drivers.emulators.world.world import World

#: The air is ramping while it is further than this from the set point.
_RAMP_C = 1.0


def phases_now(world: World, now_s: float) -> set[Phase]:
    """All phases that the bench is in at the moment ``now_s`` to which the world was brought."""
    unit, air = world.unit, world.air
    truths: dict[Phase, bool] = {
        "power_on": unit.powered,
        "align": unit.mode is Mode.ALIGN,
        "navigate": unit.mode is Mode.NAVIGATE,
        "turn": any(axis.is_moving(now_s) for axis in world.axes.values()),
        "ramp": air.running and abs(air.set_point_c - air.air_c) > _RAMP_C,
    }
    return {phase for phase, true in truths.items() if true}
