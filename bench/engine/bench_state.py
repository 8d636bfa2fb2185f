"""State of the bench: last commands, position in the plan, and newest readings of the instruments."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.navigation.table_axes import Angles
from gyrobench.bench.procedure.plan import PlannedStep
from gyrobench.bench.station.safe_state import SafeAction, SafePart
from gyrobench.bench.station.station import Station
from gyrobench.drivers.chamber import ChamberReading
from gyrobench.drivers.ins.ins_status import InsStatus
from gyrobench.drivers.rate_table import TableReading


@dataclass(frozen=True)
class Readings:
    """Newest reading of each instrument, and its time."""

    table: TableReading
    table_s: float  #: time of the reading on the run's clock; the INS status has its own age
    chamber: ChamberReading
    chamber_s: float  #: time of the reading on the run's clock
    ins: InsStatus  #: of the first unit that is measured
    polled_s: float  #: time of the last poll, answered or not


@dataclass(frozen=True)
class ExpectedState:
    """Commanded state of the instruments; the interlocks compare the readings with it."""

    chamber_set_c: float | None = None  #: set point; None if none was commanded
    chamber_on: bool | None = None  #: switched on or off; None if neither was commanded
    chamber_reached: bool = False  #: the air has reached the set point, so it should stay there
    ins_on: bool = False  #: the INS is on and has sent data, so silence is a fault
    table_prepared: bool = False  #: the table is ready to move, so open servos and faults count
    table_stopped: bool = False  #: the table was stopped, so a servo that moves it is a fault


@dataclass(frozen=True)
class RunPosition:
    """Position of a run in its plan."""

    step: int = 0  #: number in the plan; 0 outside
    dwell: int = 0  #: number in the plan; 0 outside
    cycle: int = 1  #: temperature cycle
    purpose: DwellPurpose = DwellPurpose.CALIBRATION  #: of the dwell
    power_ons: int = 0  #: how often the units were switched on
    powered_s: float = 0.0  #: time when they were last switched on, on the run's clock
    angles_deg: Angles | None = None  #: outer and inner angle last commanded; None before the first motion


class UnitState:
    """State of one unit on the bench; updated like :class:`BenchState`."""

    def __init__(self, station: Station) -> None:
        self._station = station
        self.number = ""  #: serial number of the INS; empty before it is known
        self.expected = ExpectedState()  #: what the INS should be doing
        self.position = ""  #: commanded position
        self.azimuth_deg = 0.0
        self.has_restarted = False  #: restarted without a command since it was switched on

    def table_moved_to(self, position: str, azimuth_deg: float) -> None:
        """The table has moved the first unit to a position; that of this unit depends on its mounting."""
        self.position, self.azimuth_deg = self._station.position_of_unit(position, azimuth_deg)

    def turned(self, angle_deg: float) -> None:
        """The table has turned about Up."""
        self.azimuth_deg += angle_deg

    def switched_off(self) -> None:
        """Its supply was switched off; a unit that is always on stays on."""
        self._expect_on(self._station.file.unit.power == "always_on")

    def state_unknown(self) -> None:
        """The INS may be off, regardless of its reports; it is power-cycled before it is used."""
        self._expect_on(False)

    def detected_on(self) -> None:
        """The INS sends data, without a known power-on."""
        self._expect_on(True)

    def powered(self) -> None:
        """The INS was switched on and sends data."""
        self._expect_on(True)
        self.has_restarted = False

    def restarted(self) -> None:
        """The INS restarted without a command."""
        self.has_restarted = self.has_restarted or self.expected.ins_on

    def made_safe(self, actions: Iterable[SafeAction]) -> None:
        """The safe values were commanded."""
        if any(action.part is SafePart.UNIT for action in actions):
            self._expect_on(self.expected.ins_on and self._station.file.safe_state.unit == "keep")

    def _expect_on(self, on: bool) -> None:
        self.expected = replace(self.expected, ins_on=on)


class BenchState:
    """State of one bench. It changes only by calls of its methods, each of which reports an event."""

    def __init__(self, station: Station) -> None:
        self._station = station
        self._expected = ExpectedState()
        self._run_position = RunPosition()

    @property
    def expected(self) -> ExpectedState:
        """Commanded state of the instruments."""
        return self._expected

    @property
    def run_position(self) -> RunPosition:
        """Position of the run in its plan."""
        return self._run_position

    @property
    def commanded_c(self) -> float | None:
        """Set point of the chamber; None while it is off or was not commanded."""
        return self._expected.chamber_set_c if self._expected.chamber_on else None

    # run

    def run_resumed(self, power_ons: int) -> None:
        """Continue with the number of power-ons of the run so far."""
        self._run_position = replace(self._run_position, power_ons=power_ons)

    def units_powered(self, switched_s: float) -> None:
        """The units were switched on at a time."""
        self._run_position = replace(
            self._run_position, power_ons=self._run_position.power_ons + 1, powered_s=switched_s
        )

    def step_started(self, planned: PlannedStep) -> None:
        """A step of the plan begins."""
        self._run_position = replace(
            self._run_position,
            step=planned.number,
            dwell=planned.dwell or 0,
            cycle=planned.cycle,
            purpose=planned.purpose,
        )

    # chamber

    def chamber_commanded(self, set_c: float) -> None:
        """The chamber got a set point and was switched on."""
        self._expect(chamber_set_c=set_c, chamber_on=True, chamber_reached=False)

    def chamber_switched(self, on: bool) -> None:
        """The chamber was switched on or off."""
        self.chamber_switching(on)
        self._expect(chamber_on=on, chamber_reached=False)

    def chamber_switching(self, on: bool) -> None:
        """The chamber gets a switching command that it has not acknowledged yet.

        Switching off ends a ramp, so that the chamber may hold any set point of the ramp.
        """
        self._expect(chamber_set_c=self._expected.chamber_set_c if on else None, chamber_on=None)

    def chamber_set_point_reached(self) -> None:
        """The air has reached the set point."""
        self._expect(chamber_reached=True)

    def chamber_state_unknown(self) -> None:
        """The chamber was operated at its panel, or gets a command that it has not acknowledged yet."""
        self._expect(chamber_set_c=None, chamber_on=None, chamber_reached=False)

    # rate table

    def table_prepared(self) -> None:
        """The table's servos are closed and its faults cleared."""
        self._expect(table_prepared=True, table_stopped=False)

    def table_released(self) -> None:
        """The table's servos are open."""
        self._expect(table_prepared=False)

    def table_commanded(self, angles_deg: Angles) -> None:
        """The table was commanded to outer and inner angles, deg."""
        self._run_position = replace(self._run_position, angles_deg=angles_deg)

    # all

    def made_safe(self, actions: Iterable[SafeAction]) -> None:
        """The safe values were commanded; outputs that did not acknowledge are in an unknown state."""
        safe = self._station.file.safe_state
        for action in actions:
            match action.part:
                case SafePart.CHAMBER_OFF:
                    is_on = None if action.problem else False
                    self._expect(chamber_set_c=None, chamber_on=is_on, chamber_reached=False)
                case SafePart.CHAMBER:
                    is_on = None if action.has_switched_off else self._expected.chamber_on
                    set_c = None if action.problem else safe.chamber_c
                    self._expect(chamber_set_c=set_c, chamber_on=is_on, chamber_reached=False)
                case SafePart.TABLE_AT_REST:
                    self._expect(table_prepared=False, table_stopped=not action.problem)
                case SafePart.TABLE_RELEASED:
                    self._expect(table_prepared=False)

    def _expect(self, **changes: float | bool | None) -> None:
        self._expected = replace(self._expected, **changes)  # type: ignore[arg-type]
