"""Faults of the rate table."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import override

from gyrobench.drivers.emulators.acl_axis import SoftwareFault
from gyrobench.drivers.emulators.acutrol3000 import Acutrol3000Emulator
from gyrobench.drivers.emulators.dialect import Servoed
from gyrobench.drivers.emulators.faults.fault import (
    BenchParts,
    End,
    Fault,
    Occurrence,
    Persistence,
    UnsupportedFaultError,
)
from gyrobench.drivers.emulators.world.table_axis import TableAxis
from gyrobench.drivers.emulators.world.undeclared_effects import Positive
from gyrobench.drivers.emulators.world.world import INNER, OUTER

TableTrip = Literal["rate_trip", "tracking_error", "frame_time", "fine_feedback_loss", "coarse_feedback_loss"]


class AxisFault(Fault):
    """A fault of one axis."""

    axis: Literal["outer", "inner"] = Field("inner", description="affected axis")

    @property
    def number(self) -> int:
        """Number of the axis."""
        return OUTER if self.axis == "outer" else INNER

    @override
    def check(self, bench: BenchParts) -> None:
        super().check(bench)
        try:
            self.is_servoed(bench)
        except KeyError:
            raise UnsupportedFaultError(f"this table has no {self.axis} axis") from None

    def physics(self, bench: BenchParts) -> TableAxis:
        """The physical axis."""
        return bench.world.axes[self.number]

    def is_servoed(self, bench: BenchParts) -> bool:
        """Whether the servo of the axis is closed."""
        return bench.require_capability("table", Servoed).is_servoed(self.number)


class TableStalls(AxisFault):
    """The axis ignores all commands; the controller trips on the tracking error."""

    fault: Literal["table_stalls"]

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        axis = self.physics(bench)
        axis.hold_by_force(occurrence.now_s())
        return lambda: axis.end_force(occurrence.now_s(), servo=self.is_servoed(bench))


class PositionNotReached(AxisFault):
    """Moves end before their target; beyond a degree the controller trips on the tracking error."""

    fault: Literal["position_not_reached"]
    short_by_deg: Positive = Field(0.05, description="distance from the target, deg")

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        axis = self.physics(bench)
        axis.friction_deg = self.short_by_deg

        def end() -> None:
            axis.friction_deg = 0.0
            axis.end_force(occurrence.now_s(), servo=self.is_servoed(bench))

        return end


class MovedByHand(AxisFault):
    """The axis is turned by hand against its servo, and released after ``for_s``.

    Beyond a degree the controller trips on the tracking error. Released, the axis returns if it is
    still servoed, unless ``back`` is false.
    """

    fault: Literal["moved_by_hand"]
    by_deg: float = Field(ge=-180.0, le=180.0, description="angle by which it is moved, deg")
    back: bool = Field(True, description="whether it returns at the end")

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        axis = self.physics(bench)
        axis.hold_by_force(occurrence.now_s(), self.by_deg)
        return lambda: axis.end_force(occurrence.now_s(), servo=self.back and self.is_servoed(bench))


class TableTrips(AxisFault):
    """The controller detects a fault and opens the servo; latched until a reset."""

    persistence = Persistence.MOMENTARY

    requires = ("table", Acutrol3000Emulator)
    fault: Literal["table_trips"]
    trip: TableTrip = Field("rate_trip", description="the detected fault")

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        bench.require_capability("table", Acutrol3000Emulator).trip(
            self.number, SoftwareFault[self.trip.upper()], occurrence.now_s()
        )
        return None


class InterlockOpens(AxisFault):
    """A hardware interlock opens for ``for_s``; the servo opens, latched until a reset after that."""

    requires = ("table", Acutrol3000Emulator)
    fault: Literal["interlock_opens"]
    bit: Annotated[int, Field(ge=0, le=15)] = Field(0, description="bit of the interlock register")

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        table = bench.require_capability("table", Acutrol3000Emulator)
        table.open_interlock(self.number, occurrence.now_s(), self.bit)
        return lambda: table.close_interlock(self.number, self.bit)
