"""What the bench has been commanded to do, where the run is, and what the instruments reported last."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gyrobench.bench.navigation.table_axes import Angles
from gyrobench.bench.procedure.plan import PlannedStep
from gyrobench.bench.station.station import Station
from gyrobench.drivers.chamber import ChamberReading
from gyrobench.drivers.ins.ins_status import InsStatus
from gyrobench.drivers.rate_table import TableReading


@dataclass(frozen=True)
class Readings:
    """Newest answer of each instrument, and when it came.

    Attributes
    ----------
    table, chamber, ins
        What they reported.
    table_s, chamber_s : float
        When, on the run's clock; the INS status has its own age.
    table_faults, chamber_alarms : tuple of str
        Faults and alarms that they report.
    asked_s : float
        When the instruments were last asked, whether they answered or not.
    """

    table: TableReading
    table_s: float
    table_faults: tuple[str, ...]
    chamber: ChamberReading
    chamber_s: float
    chamber_alarms: tuple[str, ...]
    ins: InsStatus
    asked_s: float = 0.0


@dataclass(frozen=True)
class ExpectedState:
    """What the instruments have been commanded to do; the interlocks compare readings with it.

    Attributes
    ----------
    chamber_set_c : float or None
        Set point; None where none was commanded.
    chamber_on : bool or None
        Whether the chamber was switched on or off; None where neither was commanded.
    chamber_reached : bool
        Whether the air has reached that set point, so that it should stay there.
    ins_on : bool
        Whether the INS is on and has sent data, so that silence is a fault.
    table_prepared : bool
        Whether the table is ready to move, so that open servos and faults count.
    """

    chamber_set_c: float | None = None
    chamber_on: bool | None = None
    chamber_reached: bool = False
    ins_on: bool = False
    table_prepared: bool = False


@dataclass(frozen=True)
class RunPosition:
    """Where a run is.

    Attributes
    ----------
    step, dwell : int
        Numbers in the plan; 0 outside.
    cycle : int
        Temperature cycle.
    is_calibration_check : bool
        Whether the dwell checks a calibration.
    unit : str
        Serial number of the INS; empty before it is known.
    power_ons : int
        How often the INS was switched on.
    powered_s : float
        When it was switched on last, on the run's clock.
    position, azimuth_deg : str, float
        Commanded position of the unit.
    angles_deg : tuple of float or None
        Outer and inner angle last commanded; None before the first motion.
    """

    step: int = 0
    dwell: int = 0
    cycle: int = 1
    is_calibration_check: bool = False
    unit: str = ""
    power_ons: int = 0
    powered_s: float = 0.0
    position: str = ""
    azimuth_deg: float = 0.0
    angles_deg: Angles | None = None


class BenchState:
    """The state of one bench. Its methods say what happened; nothing else changes it.

    Attributes
    ----------
    expected : ExpectedState
        What the instruments should be doing.
    at : RunPosition
        Where the run is.
    has_ins_restarted : bool
        Whether the INS restarted without a command since it was switched on.
    """

    def __init__(self, station: Station) -> None:
        self._station = station
        self._expected = ExpectedState()
        self._at = RunPosition()
        self._has_ins_restarted = False

    @property
    def expected(self) -> ExpectedState:  # noqa: D102 - see the class
        return self._expected

    @property
    def at(self) -> RunPosition:  # noqa: D102
        return self._at

    @property
    def has_ins_restarted(self) -> bool:  # noqa: D102
        return self._has_ins_restarted

    @property
    def commanded_c(self) -> float | None:
        """Set point of the chamber; None while it is off or was not commanded."""
        return self._expected.chamber_set_c if self._expected.chamber_on else None

    # run

    def run_resumed(self, unit: str, power_ons: int) -> None:
        """Take over unit and number of power-ons of the run so far."""
        self._at = replace(self._at, unit=unit, power_ons=power_ons)

    def step_started(self, planned: PlannedStep) -> None:
        """A step of the plan begins."""
        self._at = replace(
            self._at,
            step=planned.number,
            dwell=planned.dwell or 0,
            cycle=planned.cycle,
            is_calibration_check=planned.is_calibration_check,
        )

    # chamber

    def chamber_commanded(self, set_c: float) -> None:
        """The chamber got a set point and was switched on."""
        self._expect(chamber_set_c=set_c, chamber_on=True, chamber_reached=False)

    def chamber_switched(self, on: bool) -> None:
        """The chamber was switched on or off."""
        self._expect(chamber_on=on, chamber_reached=False)

    def chamber_set_point_reached(self) -> None:
        """The air has reached the set point."""
        self._expect(chamber_reached=True)

    def chamber_state_unknown(self) -> None:
        """The chamber was changed at its panel; it is commanded again before it is used."""
        self._expect(chamber_set_c=None, chamber_on=None)

    # INS

    def ins_switched_off(self) -> None:
        """The supply of the INS was switched off; one that is always on stays on."""
        self._expect(ins_on=self._station.unit.power == "always_on")

    def ins_state_unknown(self) -> None:
        """The INS may be off, whatever it reports; it is switched off and on before it is used."""
        self._expect(ins_on=False)

    def ins_seen_on(self) -> None:
        """The INS sends data, without a known power-on."""
        self._expect(ins_on=True)

    def ins_powered(self, switched_s: float) -> None:
        """The INS was switched on at a time and sends data."""
        self._expect(ins_on=True)
        self._has_ins_restarted = False
        self._at = replace(self._at, power_ons=self._at.power_ons + 1, powered_s=switched_s)

    def ins_restarted(self) -> None:
        """The INS restarted without a command."""
        if self._expected.ins_on:
            self._has_ins_restarted = True

    def ins_restart_handled(self) -> None:
        """The run has reacted to the restart."""
        self._has_ins_restarted = False

    def ins_identified(self, unit: str) -> None:
        """The serial number of the INS is known."""
        self._at = replace(self._at, unit=unit)

    # rate table

    def table_prepared(self) -> None:
        """The table's servos are closed and its faults cleared."""
        self._expect(table_prepared=True)

    def table_released(self) -> None:
        """The table's servos are open."""
        self._expect(table_prepared=False)

    def table_commanded(self, angles_deg: Angles) -> None:
        """The table was sent to outer and inner angles."""
        self._at = replace(self._at, angles_deg=angles_deg)

    def position_reached(self, position: str, azimuth_deg: float) -> None:
        """The unit stands in a position."""
        self._at = replace(self._at, position=position, azimuth_deg=azimuth_deg)

    # all

    def made_safe(self) -> None:
        """Every output has the safe value of the station."""
        safe = self._station.safe_state
        if safe.chamber_c is None:
            self.chamber_switched(False)
        else:
            self._expect(chamber_set_c=safe.chamber_c, chamber_reached=False)
        self._expect(ins_on=self._expected.ins_on and safe.unit == "keep", table_prepared=False)

    def _expect(self, **changes: float | bool | None) -> None:
        self._expected = replace(self._expected, **changes)  # type: ignore[arg-type]
