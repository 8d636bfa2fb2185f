"""A dwell table as arrays: the input of the search for effects."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gyrobench.bench.bias.dwell_table import UNKNOWN_UNIT, DwellRow, noise_and_common
from gyrobench.bench.closure.plausibility import implausible
from gyrobench.bench.closure.quantity import GYRO_BIAS, Quantity
from gyrobench.bench.closure.temperature_record import TemperatureRecord, record_of_dwells, set_point_path
from gyrobench.bench.closure.thermal_network import electronics_above_optics
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import listed
from gyrobench.bench.navigation.positions import POSITIONS

#: Largest share of dwells without a reading of a sensor, other than a gyro's, that is interpolated.
_MAX_MISSING = 0.1
#: Headings that differ by less than this are the same. Number of an unknown one.
_SAME_HEADING_DEG, _UNKNOWN_HEADING = 5.0, -1


@dataclass(frozen=True)
class Table:
    """A dwell table or run that a campaign was read from."""

    name: str  #: Its path.
    cycles: tuple[int, ...]  #: Its cycles, numbered as in the campaign.
    added: int = 0  #: Offset that was added to the numbers of its dwells.
    start_s: float = 0.0  #: Start of its first dwell on the campaign's clock.
    placed: str = ""  #: How its position on that clock was determined; empty for the first table.
    doubt: str = ""  #: Reason why it may be of another unit or firmware than the first; empty if known.


@dataclass(frozen=True)
class Campaign:
    """n dwells in the order of time, gyros in the order x, y, z."""

    run_names: tuple[str, ...]
    position: tuple[str, ...]  #: Names of the positions.
    #: dwell, cycle, run: Shape (n,). Number of the dwell, cycle of the profile, and index into ``run_names``
    #: (power cycles).
    dwell: IntArray
    cycle: IntArray
    run: IntArray
    up_body: FloatArray  #: Shape (n, 3). Unit vector Up in body axes.
    #: start_s, end_s, since_power_on_s: Shape (n,). Times, and time since the last power-on at the start.
    start_s: FloatArray
    end_s: FloatArray
    since_power_on_s: FloatArray
    #: set_c, air_c, case_c: Shape (n,). Chamber set point, chamber air, and case of the unit; NaN if not
    #: measured.
    set_c: FloatArray
    air_c: FloatArray
    case_c: FloatArray
    #: gyro_c, rate_c_per_h, board_c: Shape (n, 3). Optics, their slope, and electronics (NaN without a
    #: sensor).
    gyro_c: FloatArray
    rate_c_per_h: FloatArray
    board_c: FloatArray
    #: bias_dph, sigma_dph, common_sigma_dph: Shape (n, 3). Measured biases, or values of another
    #: :attr:`quantity`; their standard uncertainties that are independent from dwell to dwell, infinite if
    #: not measured; and those due to one error in all dwells of an attitude, zero if unknown.
    bias_dph: FloatArray
    sigma_dph: FloatArray
    common_sigma_dph: FloatArray
    record: TemperatureRecord  #: Temperatures of the gyros at all times, also between dwells.
    unit: str  #: Serial number of the INS.
    #: Shape (n,). Dwells that must not influence a fit to the others, not even by their temperatures.
    held_out: BoolArray
    #: Dwells of the table that were omitted because a gyro's temperature is missing.
    without_temperatures: tuple[int, ...] = ()
    #: Shape (n,). Azimuth at the start of each dwell, NaN if unknown; None if all are unknown.
    azimuth_deg: FloatArray | None = None
    #: Shape (n,) each. Other numeric columns of the table, by name.
    columns: Mapping[str, FloatArray] = field(default_factory=dict)
    quantity: Quantity = GYRO_BIAS  #: The coefficients that were measured.
    tables: tuple[Table, ...] = ()  #: The tables it was read from, in the order of time; empty without files.
    #: Shape (n, 3). Temperature of the electronics above the optics, for forecast dwells.
    forecast_above_optics_c: FloatArray | None = None
    #: The campaign including the dwells without a result, and a mask of the dwells of this one in it.
    part_of: tuple[Campaign, BoolArray] | None = None

    def __len__(self) -> int:
        """Number of dwells."""
        return len(self.dwell)

    @property
    def all_dwells(self) -> BoolArray:
        """Mask of all dwells."""
        return np.ones(len(self), dtype=bool)

    @property
    def whole(self) -> Campaign:
        """The campaign including the dwells without a result; their biases may be NaN."""
        return self if self.part_of is None else self.part_of[0]

    @property
    def in_whole(self) -> BoolArray:
        """Mask of the dwells of this campaign in :attr:`whole`."""
        return self.all_dwells if self.part_of is None else self.part_of[1]

    def of_whole(self, whole: Campaign) -> Campaign:
        """The dwells of this campaign in a changed :attr:`whole`."""
        return whole if self.part_of is None else whole.part(self.in_whole)

    @property
    def sources(self) -> list[Path]:
        """Paths of the tables and runs that it was read from."""
        return [Path(table.name) for table in self.tables]

    @property
    def fingerprints(self) -> list[str]:
        """Hash of each dwell's biases and temperatures, which identifies it in any copied or joined table."""
        rows = np.concatenate([self.bias_dph, self.gyro_c], axis=1).tolist()
        texts = (" ".join(f"{value:.5f}" for value in row) for row in rows)
        return [f"d{hashlib.sha256(text.encode()).hexdigest()[:10]}" for text in texts]

    @property
    def cycles(self) -> list[int]:
        """Numbers of the cycles, in order."""
        return list(map(int, np.unique(self.cycle)))

    @property
    def last_cycle(self) -> int:
        """The last cycle; of several tables, that of the first one with several cycles.

        A search of that table alone holds out the same cycle, so tables measured later only add searched
        dwells.
        """
        for table in self.tables if len(self.tables) > 1 else ():
            cycles = [cycle for cycle in self.cycles if cycle in table.cycles]
            if len(cycles) > 1:
                return cycles[-1]
        return self.cycles[-1]

    def cycles_of(self, name: str) -> list[int]:
        """Cycles of one of the tables. Raises MeasurementError if there is no table with that name."""
        for table in self.tables:
            if Path(table.name) == Path(name):
                return [cycle for cycle in self.cycles if cycle in table.cycles]
        names = listed([table.name for table in self.tables])
        raise MeasurementError(f"{name} can't be held out: it is not searched. Name one of {names}")

    def holding_out(self, cycles: Sequence[int]) -> Campaign:
        """The campaign with the temperatures of some cycles excluded from all fits."""
        whole = self.whole
        held_out: BoolArray = np.isin(whole.cycle, cycles)
        parts = list(whole.record.parts or (whole.record,))
        starts_s = [table_index.start_s for table_index in whole.tables[1:]] if len(parts) > 1 else []
        table_index = np.searchsorted(starts_s, whole.start_s, side="right")
        for index, part in enumerate(parts):
            if part.is_of_dwells:
                in_part = table_index == index
                dwells = (whole.start_s, whole.end_s, whole.gyro_c, whole.rate_c_per_h, held_out)
                parts[index] = record_of_dwells(*(each[in_part] for each in dwells))
        record = TemperatureRecord.joined(parts)
        return self.of_whole(replace(whole, held_out=held_out, record=record))

    def part(self, chosen: BoolArray) -> Campaign:
        """Campaign with some of the dwells; the temperature record remains that of all."""
        arrays: dict[str, Any] = {
            each.name: value[chosen]
            for each in fields(self)
            if isinstance(value := getattr(self, each.name), np.ndarray)
        }
        position = tuple(name for name, is_chosen in zip(self.position, chosen, strict=True) if is_chosen)
        columns = {name: values[chosen] for name, values in self.columns.items()}
        return replace(self, **arrays, position=position, columns=columns, part_of=(self, chosen))

    def with_uncertainties(self, sigma_dph: FloatArray) -> Campaign:
        """The campaign with other standard uncertainties (n, 3); shares the cache of this one."""
        part_of = self.part_of or (self, self.all_dwells)
        changed = replace(self, sigma_dph=sigma_dph, part_of=part_of)
        vars(changed)["_computed"] = self._computed
        return changed

    @property
    def is_measured(self) -> BoolArray:
        """Whether each value was measured, shape (n, 3)."""
        return np.isfinite(self.sigma_dph)

    @property
    def known_sigma_dph(self) -> FloatArray:
        """Standard uncertainties (n, 3), NaN if not measured."""
        return np.where(self.is_measured, self.sigma_dph, np.nan)

    def noise_dph(self, scale: FloatArray | float) -> FloatArray:
        """Standard deviation of each error (n, 3), ``scale`` (3,) times the noise stated; NaN if unknown."""
        return np.hypot(scale * self.known_sigma_dph, self.common_sigma_dph)

    @cached_property
    def common_errors_dph(self) -> FloatArray:
        """See :func:`common_errors`."""
        azimuth_deg = np.full(len(self), np.nan) if self.azimuth_deg is None else self.azimuth_deg
        return common_errors(self.position, azimuth_deg.tolist(), self.common_sigma_dph)

    @property
    def middle_s(self) -> FloatArray:
        """Middle of each dwell, shape (n,)."""
        return 0.5 * (self.start_s + self.end_s)

    @property
    def reported_unit(self) -> str:
        """Serial number of the INS; empty if it does not report one."""
        return "" if self.unit == UNKNOWN_UNIT else self.unit

    @property
    def has_one_heading(self) -> bool | None:
        """Whether all known headings are parallel or opposite; None if none is known."""
        headings = set() if self.azimuth_deg is None else set(heading_numbers(self.azimuth_deg, 180.0))
        return len(headings - {_UNKNOWN_HEADING}) == 1 if headings - {_UNKNOWN_HEADING} else None

    def slow_time(self, degree: int) -> FloatArray:
        """Chebyshev polynomials (n, degree) of the dwells' time, without the constant."""
        time = np.interp(self.middle_s, [self.middle_s.min(), self.middle_s.max()], [-1.0, 1.0])
        return np.asarray(np.polynomial.chebyshev.chebvander(time, degree)[:, 1:], dtype=np.float64)

    def computed_once(self, key: object, compute: Callable[[], FloatArray]) -> FloatArray:
        """Cached result of ``compute`` for these dwells: terms of an effect, or the course of a driver."""
        if key not in self._computed:
            self._computed[key] = compute()
        return self._computed[key]

    @cached_property
    def _computed(self) -> dict[object, FloatArray]:
        return {}

    @cached_property
    def means_over_dwells(self) -> Callable[[FloatArray], FloatArray]:
        """Function that maps values at the record's times (m, k) to their means over the dwells (n, k)."""
        return self.record.means_over(self.start_s, self.end_s)

    @cached_property
    def power_on_s(self) -> FloatArray:
        """Times of power-on, in order; at least one."""
        if self.part_of is not None:
            return self.whole.power_on_s
        times = np.unique(np.round(self.start_s - self.since_power_on_s))
        return np.asarray(times[np.diff(times, prepend=-np.inf) > 1.0])

    @cached_property
    def run_shares(self) -> FloatArray:
        """Share of each dwell in each run, shape (n, runs); a dwell may contain a power-on."""
        if self.part_of is not None:
            return self.whole.run_shares[self.in_whole]
        runs = np.arange(len(self.run_names))
        shares: FloatArray = np.asarray(self.run[:, np.newaxis] == runs, dtype=np.float64)
        for on_s in self.power_on_s:
            inside = np.flatnonzero((self.start_s < on_s) & (on_s < self.end_s))
            before, after = self.run[self.end_s <= on_s], self.run[self.start_s >= on_s]
            if len(before) and len(after):
                share = (self.end_s[inside] - on_s) / (self.end_s[inside] - self.start_s[inside])
                shares[inside] = np.outer(share, runs == after[0]) + np.outer(1.0 - share, runs == before[-1])
        return shares

    @cached_property
    def set_point_path_c(self) -> FloatArray:
        """See :func:`gyrobench.bench.closure.temperature_record.set_point_path`."""
        if self.part_of is not None:
            return self.whole.set_point_path_c[self.in_whole]
        return set_point_path(self.start_s, self.end_s, self.set_c, self.air_c)

    @cached_property
    def above_optics_c(self) -> FloatArray | None:
        """Temperature of each gyro's electronics above its optics (n, 3); None if unknown.

        From the thermal network if that describes the temperatures, otherwise as measured.
        """
        if self.forecast_above_optics_c is not None:
            return self.forecast_above_optics_c
        if self.part_of is not None:
            whole_c = self.whole.above_optics_c
            return None if whole_c is None else whole_c[self.in_whole]
        readings = np.stack([self.gyro_c, self.rate_c_per_h, self.board_c], axis=2)
        network_c = electronics_above_optics(
            self.start_s, self.end_s, self.case_c, readings, self.up_body, ~self.held_out
        )
        if network_c is None and np.isfinite(self.board_c).all():
            return self.board_c - self.gyro_c
        return network_c


def heading_numbers(azimuth_deg: Iterable[float], period_deg: float = 360.0) -> list[int]:
    """Number of the heading of each dwell, the same for azimuths that hardly differ; -1 if unknown.

    ``period_deg``: azimuths that differ by this are the same.
    """
    first_deg: list[float] = []
    numbers = []
    for each_deg in azimuth_deg:
        offsets_deg = [
            (each_deg - first + 0.5 * period_deg) % period_deg - 0.5 * period_deg for first in first_deg
        ]
        same = (number for number, each in enumerate(offsets_deg) if abs(each) < _SAME_HEADING_DEG)
        numbers.append(next(same, len(first_deg)) if math.isfinite(each_deg) else _UNKNOWN_HEADING)
        first_deg += [each_deg] if numbers[-1] == len(first_deg) else []
    return numbers


def common_errors(
    position: Sequence[str], azimuth_deg: Sequence[float], common_sigma_dph: FloatArray
) -> FloatArray:
    """Errors (3, n, c) for one standard uncertainty of each of c errors that n dwells have in common.

    A gyro has one such error in each attitude (position and heading) where it is level, and one for all where
    it is vertical, which follows Up as those of latitude and scale factor do. No dwell has two.

    Level errors in attitudes with the same vertical axis have the same causes. They may be equal or opposite,
    by the turn and the axes of the table. They are therefore independent, with a variance times the number of
    these attitudes: any course over them, such as along Up, is as uncertain as the error of one.
    """
    attitudes = list(zip(position, heading_numbers(azimuth_deg), strict=True))
    in_attitude = np.array([[each == other for other in dict.fromkeys(attitudes)] for each in attitudes])
    axes = [POSITIONS[name].up_axis for name, _ in dict.fromkeys(attitudes)]
    in_attitude = in_attitude * np.sqrt([axes.count(each) for each in axes])
    up = np.array([np.rint(POSITIONS[name].C_nb()[2]) for name in position])
    level_dph = np.where(up == 0.0, common_sigma_dph, 0.0).T
    return np.dstack([level_dph[..., np.newaxis] * in_attitude, (common_sigma_dph * up).T])


def campaign_of(
    rows: Sequence[DwellRow],
    record: TemperatureRecord | None = None,
    quantity: Quantity = GYRO_BIAS,
    *,
    is_forecast: bool = False,
) -> Campaign:
    """Campaign of the dwells that have a result and no flags; only temperatures of the others are used.

    ``rows``: in any order. ``record``: temperatures of the gyros over the whole time; by default
    interpolated between the dwells. ``quantity``: the coefficients that the rows have in place of the biases;
    except for gyro biases, one measured value is a result. ``is_forecast``: some rows are predicted, so their
    plausibility is not checked. Raises MeasurementError if no dwell has a result, the dwells are of several
    units, or the table of measured dwells is implausible.
    """
    if not rows:
        raise MeasurementError("has no dwells. Search a run with finished dwells")
    if not is_forecast and (problems := implausible(rows, quantity)):
        raise MeasurementError("\n".join(["implausible:", *problems]))
    ordered = sorted(rows, key=lambda row: (row.start_s, row.dwell))
    has_temperatures = [bool(np.isfinite([*row.gyro_c, *row.gyro_rate_c_per_h]).all()) for row in ordered]
    with_temperatures = list(itertools.compress(ordered, has_temperatures))
    min_values = 3 if quantity.is_gyro_bias else 1
    is_good = [
        not row.flags and np.isfinite([row.bias_dph, row.sigma_dph]).all(axis=0).sum() >= min_values
        for row in with_temperatures
    ]
    if not any(is_good):
        raise MeasurementError(
            "no dwell of the table has a result without flags. Measure the flagged dwells again"
        )
    units = sorted({row.unit for row in with_temperatures})
    if len(units) > 1:
        raise MeasurementError(
            f"the table has dwells of {len(units)} units ({', '.join(units)}). Split it into one table per "
            "unit"
        )
    without_temperatures = tuple(
        row.dwell for row, known in zip(ordered, has_temperatures, strict=True) if not known
    )
    whole = replace(
        _campaign_of_rows(with_temperatures, record, quantity), without_temperatures=without_temperatures
    )
    return whole if all(is_good) else whole.part(np.array(is_good))


def _campaign_of_rows(
    rows: Sequence[DwellRow], record: TemperatureRecord | None, quantity: Quantity
) -> Campaign:
    """Campaign of all dwells with temperatures, in the order of time; gyro biases may be NaN."""

    def gather(name: str) -> FloatArray:
        return np.array([getattr(row, name) for row in rows], dtype=np.float64)

    run_names = list(dict.fromkeys(row.run for row in rows))
    start_s, end_s, gyro_c, rate_c_per_h = map(gather, ("start_s", "end_s", "gyro_c", "gyro_rate_c_per_h"))
    bias_dph, boards_c = gather("bias_dph"), gather("board_c").T
    sigma_dph, common_sigma_dph = noise_and_common(rows)
    if not quantity.is_gyro_bias:
        is_unknown = ~(np.isfinite(bias_dph) & np.isfinite(sigma_dph))
        bias_dph[is_unknown], sigma_dph[is_unknown] = 0.0, np.inf
    return Campaign(
        run_names=tuple(run_names),
        position=tuple(row.position for row in rows),
        dwell=np.array([row.dwell for row in rows]),
        cycle=np.array([row.cycle for row in rows]),
        run=np.array([run_names.index(row.run) for row in rows]),
        up_body=np.array([POSITIONS[row.position].C_nb()[2] for row in rows]),
        start_s=start_s,
        end_s=end_s,
        since_power_on_s=gather("since_power_on_s"),
        set_c=_interpolated(start_s, gather("chamber_set_c")),
        air_c=_interpolated(start_s, gather("chamber_c")),
        case_c=_interpolated(start_s, gather("case_c")),
        gyro_c=gyro_c,
        rate_c_per_h=rate_c_per_h,
        board_c=np.stack([_interpolated(start_s, board_c) for board_c in boards_c], axis=1),
        bias_dph=bias_dph,
        sigma_dph=sigma_dph,
        common_sigma_dph=common_sigma_dph,
        record=record or record_of_dwells(start_s, end_s, gyro_c, rate_c_per_h),
        unit=rows[0].unit,
        held_out=np.zeros(len(rows), dtype=bool),
        azimuth_deg=gather("azimuth_deg"),
        columns=_other_columns(rows, start_s),
        quantity=quantity,
    )


def _other_columns(rows: Sequence[DwellRow], start_s: FloatArray) -> dict[str, FloatArray]:
    columns_of_rows = [dict(row.other) for row in rows]
    names = dict.fromkeys(name for each in columns_of_rows for name in each)
    return {
        name: _interpolated(start_s, np.array([each.get(name, np.nan) for each in columns_of_rows]))
        for name in names
    }


def _interpolated(time_s: FloatArray, readings: FloatArray) -> FloatArray:
    """Interpolate missing readings linearly if they are few; otherwise return them unchanged."""
    is_valid = np.isfinite(readings)
    if np.mean(is_valid) < 1.0 - _MAX_MISSING:
        return readings
    return np.interp(time_s, time_s[is_valid], readings[is_valid])
