"""Faults of the rate table."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field
from typing_extensions import override

from drivers.emulators.acl_axis import AclAxis, SoftwareFault
from drivers.emulators.faults.fault import BenchParts, End, Fault, Occurrence
from drivers.emulators.faults.timing import Lasting
from drivers.emulators.world.quantities import Positive
from drivers.emulators.world.world import INNER, OUTER

Trip = Literal["rate_trip", "tracking_error", "frame_time", "fine_feedback_loss", "coarse_feedback_loss"]


class AxisFault(Fault):
    """A fault of one axis."""

    axis: Literal["outer", "inner"] = "inner"

    def of(self, bench: BenchParts) -> AclAxis:
        """The axis, as the controller sees it at this moment."""
        return bench.table.axes[self.number]

    @property
    def number(self) -> int:
        """Number of the axis."""
        return OUTER if self.axis == "outer" else INNER


class TableStalls(AxisFault):
    """The axis stands still whatever it is told; the controller trips on the tracking error."""

    fault: Literal["table_stalls"]

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        axis = self.of(bench)
        axis.physics.overcome(occurrence.now_s())
        occurrence.record()
        return lambda: axis.physics.let_go(occurrence.now_s(), servo=axis.closed)


class PositionNotReached(AxisFault):
    """Moves end before their target; beyond a degree the controller trips on the tracking error."""

    fault: Literal["position_not_reached"]
    short_by_deg: Positive = 0.05

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        axis = self.of(bench)
        axis.physics.friction_deg = self.short_by_deg
        occurrence.record()

        def end() -> None:
            axis.physics.friction_deg = 0.0
            axis.physics.let_go(occurrence.now_s(), servo=axis.closed)

        return end


class MovedByHand(AxisFault):
    """Somebody turns the axis against its servo, and lets go after ``for_s``.

    Beyond a degree the controller trips on the tracking error. Let go, the axis goes back if it is
    still servoed, unless ``back`` is false.
    """

    fault: Literal["moved_by_hand"]
    by_deg: Annotated[float, Field(ge=-180.0, le=180.0)]
    back: bool = True

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        axis = self.of(bench)
        axis.physics.overcome(occurrence.now_s(), self.by_deg)
        occurrence.record()
        return lambda: axis.physics.let_go(occurrence.now_s(), servo=self.back and axis.closed)


class TableTrips(AxisFault):
    """The controller finds a fault and opens the servo; latched until a reset."""

    lasting: ClassVar[Lasting] = Lasting.MOMENT

    fault: Literal["table_trips"]
    trip: Trip = "rate_trip"

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        bench.table.trip(self.number, SoftwareFault[self.trip.upper()], occurrence.now_s())
        occurrence.record()
        return None


class InterlockOpens(AxisFault):
    """A hardware interlock opens for ``for_s``; the servo is lost, latched until a reset after that."""

    fault: Literal["interlock_opens"]
    bit: Annotated[int, Field(ge=0, le=15)] = Field(0, description="bit of the interlock register")

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        bench.table.open_interlock(self.number, occurrence.now_s(), self.bit)
        occurrence.record()
        return lambda: bench.table.close_interlock(self.number, self.bit)


TableFault = TableStalls | PositionNotReached | MovedByHand | TableTrips | InterlockOpens
