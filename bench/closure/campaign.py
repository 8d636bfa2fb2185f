"""A dwell table as arrays: the input of the search for effects."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gyrobench.bench.bias.dwell_table import UNKNOWN_UNIT, DwellRow
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
#: Headings that differ by less are one.
_SAME_HEADING_DEG = 5.0


@dataclass(frozen=True)
class Table:
    """A dwell table or run that a campaign was read from."""

    name: str  #: Its path.
    cycles: tuple[int, ...]  #: Its cycles, numbered as in the campaign.
    added: int = 0  #: What was added to the numbers of its dwells.
    start_s: float = 0.0  #: Start of its first dwell on the campaign's clock.
    placed: str = ""  #: How its place on that clock was found; empty for the first.
    doubt: str = ""  #: Why it may be of another unit than the first, or of another firmware; empty if known.


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
    #: bias_dph, sigma_dph: Shape (n, 3). Measured biases, or values of another :attr:`quantity`, and their
    #: standard uncertainties: infinite where nothing was measured.
    bias_dph: FloatArray
    sigma_dph: FloatArray
    record: TemperatureRecord  #: Temperatures of the gyros at all times, also between dwells.
    unit: str  #: Serial number of the INS.
    #: Shape (n,). Dwells of which not even the temperatures may influence a fit to the others.
    held_out: BoolArray
    #: Dwells of the table that are left out because a gyro's temperature is missing.
    without_temperatures: tuple[int, ...] = ()
    #: Shape (n,). Azimuth at the start of each dwell, NaN where not known; None as NaN.
    azimuth_deg: FloatArray | None = None
    #: Shape (n,) each. Other numbers of the dwells, by column of the table.
    columns: Mapping[str, FloatArray] = field(default_factory=dict)
    quantity: Quantity = GYRO_BIAS  #: What was measured.
    tables: tuple[Table, ...] = ()  #: What it was read from, in the order of time; empty without files.
    #: Shape (n, 3). Temperature of the electronics above the optics, where dwells are forecast.
    forecast_above_optics_c: FloatArray | None = None
    #: The campaign including the dwells without a result, and which of its dwells these are.
    part_of: tuple[Campaign, BoolArray] | None = None

    def __len__(self) -> int:
        """Number of dwells."""
        return len(self.dwell)

    @property
    def whole(self) -> Campaign:
        """The campaign including the dwells without a result; their biases may be NaN."""
        return self if self.part_of is None else self.part_of[0]

    @property
    def sources(self) -> list[Path]:
        """Paths of the tables and runs that it was read from."""
        return [Path(table.name) for table in self.tables]

    @property
    def fingerprints(self) -> list[str]:
        """Each dwell by its biases and temperatures, as they remain in a copied, joined or renamed table."""
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

        It is what a search of that table alone holds out: tables measured later add to what is searched.
        """
        for table in self.tables if len(self.tables) > 1 else ():
            cycles = [cycle for cycle in self.cycles if cycle in table.cycles]
            if len(cycles) > 1:
                return cycles[-1]
        return self.cycles[-1]

    def cycles_of(self, name: str) -> list[int]:
        """Cycles of one of the tables. Raises MeasurementError if it is none of them."""
        for table in self.tables:
            if Path(table.name) == Path(name):
                return [cycle for cycle in self.cycles if cycle in table.cycles]
        names = listed([table.name for table in self.tables])
        raise MeasurementError(f"{name} can't be held out: it is not searched. Name one of {names}")

    def holding_out(self, cycles: Sequence[int]) -> Campaign:
        """Same campaign with the temperatures of some cycles excluded from all fits."""
        whole = self.whole
        held_out: BoolArray = np.isin(whole.cycle, cycles)
        parts = list(whole.record.parts or (whole.record,))
        starts_s = [table.start_s for table in whole.tables[1:]] if len(parts) > 1 else []
        table = np.searchsorted(starts_s, whole.start_s, side="right")
        for index, part in enumerate(parts):
            if part.is_of_dwells:
                mine = table == index
                dwells = (whole.start_s, whole.end_s, whole.gyro_c, whole.rate_c_per_h, held_out)
                parts[index] = record_of_dwells(*(each[mine] for each in dwells))
        record = TemperatureRecord.joined(parts)
        whole = replace(whole, held_out=held_out, record=record)
        return whole if self.part_of is None else whole.part(self.part_of[1])

    def part(self, chosen: BoolArray) -> Campaign:
        """Some of the dwells; the course of temperatures remains that of all."""
        arrays: dict[str, Any] = {
            each.name: value[chosen]
            for each in fields(self)
            if isinstance(value := getattr(self, each.name), np.ndarray)
        }
        position = tuple(name for name, taken in zip(self.position, chosen, strict=True) if taken)
        columns = {name: values[chosen] for name, values in self.columns.items()}
        return replace(self, **arrays, position=position, columns=columns, part_of=(self, chosen))

    def with_uncertainties(self, sigma_dph: FloatArray) -> Campaign:
        """Same campaign with other standard uncertainties (n, 3); what is computed of the rest is shared."""
        everything = self.part_of or (self, np.ones(len(self), dtype=bool))
        changed = replace(self, sigma_dph=sigma_dph, part_of=everything)
        vars(changed)["_computed"] = self._computed
        return changed

    @property
    def is_measured(self) -> BoolArray:
        """Which of the values were measured, shape (n, 3)."""
        return np.isfinite(self.sigma_dph)

    @property
    def known_sigma_dph(self) -> FloatArray:
        """Standard uncertainties (n, 3), NaN where nothing was measured."""
        return np.where(self.is_measured, self.sigma_dph, np.nan)

    @property
    def middle_s(self) -> FloatArray:
        """Middle of each dwell, shape (n,)."""
        return 0.5 * (self.start_s + self.end_s)

    @property
    def reported_unit(self) -> str:
        """Serial number of the INS; empty where it does not report one."""
        return "" if self.unit == UNKNOWN_UNIT else self.unit

    @property
    def has_one_heading(self) -> bool | None:
        """Whether all known headings are one or its opposite; None if none is known."""
        headings_deg = np.zeros(0) if self.azimuth_deg is None else self.azimuth_deg
        headings_deg = headings_deg[np.isfinite(headings_deg)]
        # A pair at 0 and 180 deg is the pair at 180 and 360 deg.
        off_deg = (headings_deg - headings_deg[:1] + 90.0) % 180.0 - 90.0
        return bool(np.all(np.abs(off_deg) < _SAME_HEADING_DEG)) if len(off_deg) else None

    def slow_time(self, degree: int) -> FloatArray:
        """Chebyshev polynomials of the dwells' time up to a degree, without the constant: (n, degree)."""
        time = np.interp(self.middle_s, [self.middle_s.min(), self.middle_s.max()], [-1.0, 1.0])
        return np.asarray(np.polynomial.chebyshev.chebvander(time, degree)[:, 1:], dtype=np.float64)

    def computed_once(self, key: object, compute: Callable[[], FloatArray]) -> FloatArray:
        """What is computed for these dwells, kept by a key: terms of an effect, or the course of a driver."""
        if key not in self._computed:
            self._computed[key] = compute()
        return self._computed[key]

    @cached_property
    def _computed(self) -> dict[object, FloatArray]:
        return {}

    @cached_property
    def means_over_dwells(self) -> Callable[[FloatArray], FloatArray]:
        """Function of values at the record's times (m, k): their means over the dwells (n, k)."""
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
        """Share of each dwell in each run, shape (n, runs): a dwell may contain a power-on."""
        if self.part_of is not None:
            return self.whole.run_shares[self.part_of[1]]
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
            return self.whole.set_point_path_c[self.part_of[1]]
        return set_point_path(self.start_s, self.end_s, self.set_c, self.air_c)

    @cached_property
    def above_optics_c(self) -> FloatArray | None:
        """Temperature of each gyro's electronics above its optics (n, 3); None if unknown.

        By the thermal network if that describes the temperatures, otherwise as measured.
        """
        if self.forecast_above_optics_c is not None:
            return self.forecast_above_optics_c
        if self.part_of is not None:
            whole_c = self.whole.above_optics_c
            return None if whole_c is None else whole_c[self.part_of[1]]
        readings = np.stack([self.gyro_c, self.rate_c_per_h, self.board_c], axis=2)
        fitted = electronics_above_optics(
            self.start_s, self.end_s, self.case_c, readings, self.up_body, ~self.held_out
        )
        if fitted is None and np.isfinite(self.board_c).all():
            return self.board_c - self.gyro_c
        return fitted


def campaign_of(
    rows: Sequence[DwellRow],
    record: TemperatureRecord | None = None,
    quantity: Quantity = GYRO_BIAS,
    *,
    is_forecast: bool = False,
) -> Campaign:
    """Collect the dwells that have a result and no flags; of the others only temperatures are used.

    ``rows``: in any order. ``record``: temperatures of the gyros over the whole time; by default
    interpolated between the dwells. ``quantity``: what the rows have in the place of the biases; of others
    than the gyros' biases one measured value is a result. ``is_forecast``: some are not measured. Raises
    MeasurementError if no dwell has a result, the dwells are of several units, or the table of measured ones
    is implausible.
    """
    if not rows:
        raise MeasurementError("has no dwells. Search a run with finished dwells")
    if not is_forecast and (problems := implausible(rows, quantity)):
        raise MeasurementError("\n".join(["implausible:", *problems]))
    ordered = sorted(rows, key=lambda row: (row.start_s, row.dwell))
    is_warm = [bool(np.isfinite([*row.gyro_c, *row.gyro_rate_c_per_h]).all()) for row in ordered]
    warm = list(itertools.compress(ordered, is_warm))
    enough = 3 if quantity.is_gyro_bias else 1
    good = [
        not row.flags and np.isfinite([row.bias_dph, row.sigma_dph]).all(axis=0).sum() >= enough
        for row in warm
    ]
    if not any(good):
        raise MeasurementError(
            "no dwell of the table has a result without flags. Measure the flagged dwells again"
        )
    units = sorted({row.unit for row in warm})
    if len(units) > 1:
        raise MeasurementError(
            f"the table has dwells of {len(units)} units ({', '.join(units)}). Split it into one table per "
            "unit"
        )
    cold = tuple(row.dwell for row, known in zip(ordered, is_warm, strict=True) if not known)
    whole = replace(_of_rows(warm, record, quantity), without_temperatures=cold)
    return whole if all(good) else whole.part(np.array(good))


def _of_rows(rows: Sequence[DwellRow], record: TemperatureRecord | None, quantity: Quantity) -> Campaign:
    """Campaign of all dwells with temperatures, in the order of time; gyro biases may be NaN."""

    def gather(name: str) -> FloatArray:
        return np.array([getattr(row, name) for row in rows], dtype=np.float64)

    names = list(dict.fromkeys(row.run for row in rows))
    start_s, end_s, gyro_c, rate_c_per_h = map(gather, ("start_s", "end_s", "gyro_c", "gyro_rate_c_per_h"))
    bias_dph, sigma_dph, boards_c = gather("bias_dph"), gather("sigma_dph"), gather("board_c").T
    if not quantity.is_gyro_bias:
        is_unknown = ~(np.isfinite(bias_dph) & np.isfinite(sigma_dph))
        bias_dph[is_unknown], sigma_dph[is_unknown] = 0.0, np.inf
    return Campaign(
        run_names=tuple(names),
        position=tuple(row.position for row in rows),
        dwell=np.array([row.dwell for row in rows]),
        cycle=np.array([row.cycle for row in rows]),
        run=np.array([names.index(row.run) for row in rows]),
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
        record=record or record_of_dwells(start_s, end_s, gyro_c, rate_c_per_h),
        unit=rows[0].unit,
        held_out=np.zeros(len(rows), dtype=bool),
        azimuth_deg=gather("azimuth_deg"),
        columns=_other_columns(rows, start_s),
        quantity=quantity,
    )


def _other_columns(rows: Sequence[DwellRow], start_s: FloatArray) -> dict[str, FloatArray]:
    known = [dict(row.other) for row in rows]
    names = dict.fromkeys(name for each in known for name in each)
    return {
        name: _interpolated(start_s, np.array([each.get(name, np.nan) for each in known])) for name in names
    }


def _interpolated(time_s: FloatArray, readings: FloatArray) -> FloatArray:
    """Interpolate a few missing readings linearly; return many missing ones unchanged."""
    known = np.isfinite(readings)
    if np.mean(known) < 1.0 - _MAX_MISSING:
        return readings
    return np.interp(time_s, time_s[known], readings[known])
