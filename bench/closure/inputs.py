"""Input of a search: dwells of run folders and tables, joined on one time axis, and their temperatures."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.bias.dwell_table import NOT_MEASURED, DwellRow, read_dwells
from gyrobench.bench.closure.campaign import Campaign, Table, campaign_of
from gyrobench.bench.closure.quantity import GYRO_BIAS, Quantity
from gyrobench.bench.closure.temperature_record import TemperatureRecord
from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import AXES, POSITIONS
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.marks import purpose_of
from gyrobench.bench.runs.provenance import ins_identity, read_provenance, started_utc
from gyrobench.bench.runs.tables.coefficient_table import PlateauCoefficientRow, read_coefficients_for_fit
from gyrobench.bench.runs.telemetry import read_telemetry

_MIN_SAMPLES = 2
_STEP_S = 30.0
_MAX_STEPS = 20_000
#: Assumed time from the end of a table to the power-on of the next if no common clock is known.
ASSUMED_PAUSE_S = 3600.0
_SAME_S = 1.0
_ON_CLOCK = "on the clock of "


def read_campaign(*paths: Path, quantity: Quantity = GYRO_BIAS) -> Campaign:
    """Read the dwells of tables and runs of one unit, with the temperatures between dwells if there are runs.

    ``paths``: dwell tables or run folders, at least one; several are joined on one time axis, see
    :func:`join_tables`. ``quantity``: the coefficients that replace the gyro biases, from the columns
    :func:`coefficient_columns`. Raises DocumentError if there is no dwell table, or it is wrong. Raises
    RunFolderError if a folder is not a run folder, or its telemetry can't be read. Raises MeasurementError if
    there are no good dwells, dwells of several units, or tables that can't be joined.
    """
    sources = [_read_source(path, quantity) for path in paths]
    if len(sources) > 1:
        return join_tables(sources)
    [source] = sources
    cycles = tuple(np.unique(source.campaign.whole.cycle).tolist())
    whole = replace(source.campaign.whole, tables=(Table(source.name, cycles),))
    return source.campaign.of_whole(whole)


def _read_source(path: Path, quantity: Quantity) -> TableToJoin:
    record, began_s, ins = None, None, ""
    # A path that does not exist is that of a table if it has a suffix.
    table, is_run = path, path.is_dir() or not (path.suffix or path.exists())
    if is_run:
        folder = open_run_folder(path)
        table = folder.dwells
        if not table.exists():
            advice = _advice_without_dwells(folder)
            raise MeasurementError(f"{path}: no dwell was finished in this run: nothing to search. {advice}")
        record = temperature_record(read_telemetry(folder.telemetry))
        provenance = read_provenance(folder)
        options = provenance.get("options", {})
        is_calendar = options.get("clock") != "virtual" and "speed" not in options
        if "started_utc" in provenance and is_calendar:
            began_s = started_utc(folder).timestamp()
        ins = ins_identity(folder)
    try:
        rows, quantity = _rows_of(read_dwells(table), quantity, path if is_run else None)
        if record is not None:
            record = replace(record, gyro_c=record.gyro_c[:, quantity.sensors])
        return TableToJoin(str(path), campaign_of(rows, record, quantity), is_run, began_s, ins)
    except MeasurementError as error:
        raise MeasurementError(f"{table}: {error}") from error


def _advice_without_dwells(folder: RunFolder) -> str:
    entries = read_journal(folder.journal)
    if any(purpose_of(entry.get("marks")) is DwellPurpose.ROTATIONS for entry in entries):
        return "Rotations need a dwell (align, navigate, turn, navigate) before them at the same set point"
    return "Search a run with finished dwells (align, navigate, turn, navigate)"


def coefficient_columns(quantity: Quantity) -> list[tuple[str, str]]:
    """Columns of a dwell table with the value and the standard uncertainty of each coefficient."""
    unit = quantity.suffix
    return [(f"{name}_{unit}", f"{name}_sigma_{unit}") for name in quantity.coefficients]


def _rows_of(
    rows: Sequence[DwellRow], quantity: Quantity, run: Path | None
) -> tuple[list[DwellRow], Quantity]:
    """Rows with the coefficients searched in place of the biases; NaN if not measured.

    If the table has no columns for them, they are those of the plateaus of a run, and the rows are plateaus.
    Accelerometer biases are those of the dwells, without the vertical ones, which a dwell does not determine.
    """
    if quantity.is_gyro_bias:
        return list(rows), quantity
    columns = coefficient_columns(quantity)
    if any(name in dict(row.other) for row in rows for name, _ in columns):
        values = np.array(
            [[[dict(row.other).get(name, np.nan) for name in pair] for pair in columns] for row in rows]
        )
    elif quantity.name == "accelerometer_bias":
        values = np.array([[row.accelerometer_ug, row.accelerometer_sigma_ug] for row in rows]).mT
        values[np.arange(len(rows)), [POSITIONS[row.position].up_axis for row in rows]] = np.nan
    elif run is not None and RunFolder(run).coefficients.exists():
        coefficients = read_coefficients_for_fit(RunFolder(run).coefficients, RunFolder(run).budget)
        return _plateau_rows(rows, coefficients, quantity), replace(quantity, row="plateau")
    else:
        raise MeasurementError(
            f"has no columns {columns[0][0]}, {columns[0][1]}, ... Search a table with the coefficients of "
            "each dwell"
        )
    is_measured_here = quantity.name == "accelerometer_bias" and columns[0][0] not in dict(rows[0].other)
    return [
        replace(
            _with_values(row, value_pairs, quantity.sensors),
            common_sigma_dph=row.accelerometer_common_sigma_ug if is_measured_here else NOT_MEASURED,
        )
        for row, value_pairs in zip(rows, values, strict=True)
    ], quantity


def _plateau_rows(
    rows: Sequence[DwellRow], coefficients: Sequence[PlateauCoefficientRow], quantity: Quantity
) -> list[DwellRow]:
    """One row for each plateau with rotations and dwells: times of the dwells, coefficients of the plateau.

    All rows get one position, since the coefficients of a plateau are from all its positions. Visits to a set
    point in the same cycle are matched in the order of time. Raises MeasurementError if no plateau has
    rotations.
    """
    plateaus: dict[int, dict[str, PlateauCoefficientRow]] = {}
    for each in coefficients:
        plateaus.setdefault(each.plateau, {})[each.name] = each
    rotated = [
        by_name
        for by_name in plateaus.values()
        if np.isfinite([row.gyro_rate_c_per_h for row in by_name.values()]).any()
    ]
    if not rotated:
        raise MeasurementError(
            f"{quantity.name} needs rotations, and the run has none that could be evaluated. Use a procedure "
            "with rotate and spin, such as full_calibration"
        )
    usable = [row for row in rows if not row.flags]
    visits: dict[tuple[int, str], list[list[DwellRow]]] = {}
    for key, group in itertools.groupby(usable, _plateau_key):
        visits.setdefault(key, []).append(list(group))
    result = []
    for by_name in rotated:
        if visit := visits.get(_plateau_key(next(iter(by_name.values())))):
            dwells = visit.pop(0)
            means: dict[str, Any] = {
                name: tuple(np.mean([getattr(row, name) for row in dwells], axis=0).tolist())
                for name in ("gyro_rate_c_per_h", "board_c")
            }
            biases = [by_name[f"gyro_bias_{axis}"] for axis in AXES]
            means["gyro_c"] = tuple(each.temperature_c for each in biases)
            if np.isfinite([each.gyro_rate_c_per_h for each in biases]).all():
                means["gyro_rate_c_per_h"] = tuple(each.gyro_rate_c_per_h for each in biases)
            row = replace(dwells[0], end_s=dwells[-1].end_s, position=rows[0].position, **means)
            pairs = [(by_name[name].value, by_name[name].sigma) for name in quantity.coefficients]
            result.append(_with_values(row, np.array(pairs), quantity.sensors))
    return result


def _plateau_key(each: DwellRow | PlateauCoefficientRow) -> tuple[int, str]:
    """Key of cycle and set point, which may be NaN."""
    return each.cycle, f"{each.chamber_set_c:z.2f}"


def _with_values(row: DwellRow, pairs: FloatArray, sensors: Sequence[int]) -> DwellRow:
    """Row with values and uncertainties (3, 2) of sensors in place of the biases."""
    triples: dict[str, Any] = {
        name: tuple(getattr(row, name)[each] for each in sensors)
        for name in ("gyro_c", "gyro_rate_c_per_h", "board_c")
    }
    triples |= {"bias_dph": tuple(pairs[:, 0].tolist()), "sigma_dph": tuple(pairs[:, 1].tolist())}
    triples |= {"common_sigma_dph": NOT_MEASURED}
    return replace(row, **triples)


@dataclass(frozen=True)
class TableToJoin:
    """A table or run before it is joined."""

    name: str  #: Its path, for messages.
    campaign: Campaign
    is_run: bool = False  #: A run folder; its times begin with the run.
    began_s: float | None = None  #: Calendar time (UTC) at zero of its clock; None if unknown.
    ins: str = ""  #: How the INS of a run identified; empty if unknown.

    @property
    def start_s(self) -> float:
        """Start of its first dwell on its own clock."""
        return float(self.campaign.whole.start_s.min())

    @property
    def end_s(self) -> float:
        """End of its last dwell on its own clock."""
        return float(self.campaign.whole.end_s.max())

    @property
    def power_on_s(self) -> float:
        """Power-on before its first dwell, on its own clock."""
        return float(self.campaign.power_on_s[0])

    def is_after(self, other: TableToJoin) -> bool:
        """Whether this table continues another one on the same clock."""
        shared_runs = {self.campaign.whole.run_names[0]} & set(other.campaign.whole.run_names)
        other_power_ons_s = other.campaign.power_on_s if shared_runs else np.empty(0)
        is_same_power_cycle = np.any(np.abs(other_power_ons_s - self.power_on_s) <= _SAME_S)
        begins = is_same_power_cycle or self.power_on_s >= other.end_s - _SAME_S
        return not self.is_run and self.start_s >= other.end_s - 1e-3 and bool(begins)


def join_tables(sources: Sequence[TableToJoin]) -> Campaign:
    """Join tables of one unit on one time axis, with unique numbers of dwells and cycles.

    Runs with a calendar time are placed by it. A table that continues the previous one on its clock keeps its
    times; any other is placed so that its power-on is :data:`ASSUMED_PAUSE_S` after the end of the previous.

    Raises MeasurementError if they are of several units, overlap in time, or have dwells in common.
    """
    sources = _in_time_order(sources)
    first = sources[0]
    for each in sources[1:]:
        if each.campaign.unit != first.campaign.unit:
            raise MeasurementError(
                f"{each.name} is of unit {each.campaign.unit}, {first.name} of unit {first.campaign.unit}. "
                "Search each unit by itself"
            )
    parts: list[Campaign] = []
    tables: list[Table] = []
    shifts_s: list[float] = []
    for index, each in enumerate(sources):
        shift_s, placed = _clock_shift(each, sources[:index], shifts_s)
        part = _on_common_clock(each, shift_s, parts, is_on_clock=placed.startswith(_ON_CLOCK))
        shifts_s.append(shift_s)
        parts.append(part)
        whole = part.whole
        tables.append(
            Table(
                each.name,
                tuple(np.unique(whole.cycle).tolist()),
                int(whole.dwell[0] - each.campaign.whole.dwell[0]),
                float(whole.start_s[0]),
                placed,
                _doubt(each, first) if index else "",
            )
        )
    return _concatenate(parts, tables)


def _doubt(source: TableToJoin, first: TableToJoin) -> str:
    """Reason why a table may be of another unit or firmware than the first; empty if it is not."""
    if source.ins and first.ins and source.ins != first.ins:
        return f"its INS identifies as {source.ins}, that of {first.name} as {first.ins}"
    if source.campaign.reported_unit:
        return ""
    return f"without a serial number: taken for the unit of {first.name}"


def _in_time_order(sources: Sequence[TableToJoin]) -> list[TableToJoin]:
    """Sources in the order of time if that is known, otherwise as given."""
    began_s = [each.began_s for each in sources if each.began_s is not None]
    if len(began_s) == len(sources):
        return [sources[index] for index in np.argsort(began_s, kind="stable")]
    in_time = sorted(sources, key=lambda each: each.start_s)
    return in_time if all(later.is_after(each) for each, later in pairwise(in_time)) else list(sources)


def _clock_shift(
    source: TableToJoin, before: Sequence[TableToJoin], shifts_s: Sequence[float]
) -> tuple[float, str]:
    """Time to add to a source's clock, and how it was determined."""
    if not before:
        return 0.0, ""
    for other in before:
        own_biases, other_biases = source.campaign.whole.bias_dph, other.campaign.whole.bias_dph
        common = np.flatnonzero((own_biases[:, np.newaxis] == other_biases).all(axis=2).any(axis=1))
        if len(common):
            raise MeasurementError(
                f"{source.name}: {len(common)} of its dwells, the first is number "
                f"{source.campaign.whole.dwell[common[0]]}, are also in {other.name}. Give each dwell once"
            )
    last, last_shift_s = before[-1], shifts_s[-1]
    end_s = last.end_s + last_shift_s
    for other, other_shift_s in zip(before, shifts_s, strict=True):
        if source.began_s is not None and other.began_s is not None:
            shift_s = other_shift_s + source.began_s - other.began_s
            overlap_s = end_s - source.start_s - shift_s
            if overlap_s > _SAME_S:
                raise MeasurementError(
                    f"{source.name} starts {overlap_s / 3600.0:.2f} h before {last.name} ends. A unit can't "
                    "be in two runs: leave one out"
                )
            return shift_s, "by its calendar time"
    if source.is_after(last):
        return last_shift_s, f"{_ON_CLOCK}{last.name}"
    return end_s + ASSUMED_PAUSE_S - source.power_on_s, f"after {last.name}: it has no common clock with it"


def _on_common_clock(
    source: TableToJoin, shift_s: float, before: Sequence[Campaign], *, is_on_clock: bool
) -> Campaign:
    """Campaign on the common clock, with numbers of dwells and cycles and runs unused by those before."""
    campaign = source.campaign
    whole = campaign.whole
    names: list[str] = list(before[-1].run_names) if before else []
    known_s = np.concatenate([each.power_on_s for each in before]) if before else np.empty(0)
    runs = []
    for index, name in enumerate(whole.run_names):
        power_ons_s = (whole.start_s - whole.since_power_on_s)[whole.run == index]
        if not len(power_ons_s):  # only dwells that were left out, as those of a held-out cycle
            runs.append(-1)
            continue
        power_on_s = shift_s + float(power_ons_s.min())
        if name in names and not np.any(np.abs(known_s - power_on_s) <= _SAME_S):
            name = f"{name} ({source.name})"
        names += [] if name in names else [name]
        runs.append(names.index(name))

    last_cycle = _highest([each.whole.cycle for each in before])
    continues_cycle = is_on_clock and whole.cycle.min() == last_cycle
    shifted = replace(
        whole,
        run_names=tuple(names),
        run=np.array(runs)[whole.run],
        dwell=_above_used(_highest([each.whole.dwell for each in before]), whole.dwell),
        cycle=whole.cycle if continues_cycle else _above_used(last_cycle, whole.cycle),
        start_s=whole.start_s + shift_s,
        end_s=whole.end_s + shift_s,
        record=replace(whole.record, time_s=whole.record.time_s + shift_s),
    )
    return campaign.of_whole(shifted)


def _highest(used: Sequence[IntArray]) -> float:
    return max((float(each.max()) for each in used), default=-np.inf)


def _above_used(highest: float, numbers: IntArray) -> IntArray:
    """Numbers, shifted above the highest one used if the first is not above it."""
    first = int(numbers.min())
    return numbers if first > highest else numbers + int(highest) + 1 - first


def _concatenate(parts: Sequence[Campaign], tables: Sequence[Table]) -> Campaign:
    campaigns = [each.whole for each in parts]
    arrays: dict[str, Any] = {
        each.name: np.concatenate([getattr(whole, each.name) for whole in campaigns])
        for each in fields(Campaign)
        if each.name != "azimuth_deg" and isinstance(getattr(campaigns[0], each.name), np.ndarray)
    }
    joined = replace(
        campaigns[-1],
        **arrays,
        position=tuple(name for whole in campaigns for name in whole.position),
        record=TemperatureRecord.joined([whole.record for whole in campaigns]),
        azimuth_deg=np.concatenate([_or_nan(whole, whole.azimuth_deg) for whole in campaigns]),
        columns={
            name: np.concatenate([_or_nan(whole, whole.columns.get(name)) for whole in campaigns])
            for name in dict.fromkeys(name for whole in campaigns for name in whole.columns)
        },
        without_temperatures=tuple(
            dwell + table.added
            for whole, table in zip(campaigns, tables, strict=True)
            for dwell in whole.without_temperatures
        ),
        tables=tuple(tables),
    )
    is_good = np.concatenate([each.in_whole for each in parts])
    return joined if is_good.all() else joined.part(is_good)


def _or_nan(whole: Campaign, values: FloatArray | None) -> FloatArray:
    return np.full(len(whole), np.nan) if values is None else values


def joined_rows(campaign: Campaign) -> list[DwellRow]:
    """Rows of the tables of a campaign in the order of time, with its times, numbers and names of runs."""
    whole, rows = campaign.whole, list[DwellRow]()
    index_of_dwell = {dwell: index for index, dwell in enumerate(whole.dwell.tolist())}
    for table in campaign.tables:
        path = Path(table.name)
        table_rows = read_dwells(open_run_folder(path).dwells if path.is_dir() else path)
        index_in_table = {
            row.dwell: index_of_dwell[row.dwell + table.added]
            for row in table_rows
            if row.dwell + table.added in index_of_dwell
        }
        first = next(row for row in table_rows if row.dwell in index_in_table)
        shift_s = float(whole.start_s[index_in_table[first.dwell]]) - first.start_s
        cycles = int(whole.cycle[index_in_table[first.dwell]]) - first.cycle
        names = {
            row.run: whole.run_names[whole.run[index_in_table[row.dwell]]]
            for row in table_rows
            if row.dwell in index_in_table
        }
        rows += [
            replace(
                row,
                dwell=row.dwell + table.added,
                cycle=row.cycle + cycles,
                run=names.get(row.run, row.run),
                start_s=row.start_s + shift_s,
                end_s=row.end_s + shift_s,
            )
            for row in table_rows
        ]
    return sorted(rows, key=lambda row: (row.start_s, row.dwell))


def temperature_record(telemetry: Mapping[str, FloatArray]) -> TemperatureRecord | None:
    """Temperature record of a run at equal time steps; None if a gyro's temperature was not read.

    Readings are interpolated linearly.
    """
    time_s = telemetry["time_s"]
    readings = [telemetry[f"gyro_{axis}_c"] for axis in AXES]
    readings += [telemetry["chamber_c"]] if np.isfinite(telemetry["chamber_c"]).sum() >= _MIN_SAMPLES else []
    valid = [np.isfinite(each) for each in readings]
    if any(np.count_nonzero(each) < _MIN_SAMPLES for each in valid):
        return None
    first_s, last_s = float(time_s[0]), float(time_s[-1])
    steps = min(max(round((last_s - first_s) / _STEP_S), 1), _MAX_STEPS)
    grid_s = np.linspace(first_s, last_s, steps + 1)
    grid_c = np.stack(
        [
            np.interp(grid_s, time_s[is_valid], values[is_valid])
            for values, is_valid in zip(readings, valid, strict=True)
        ],
        axis=1,
    )
    air_c = grid_c[:, 3] if len(readings) > len(AXES) else None
    return TemperatureRecord(grid_s, grid_c[:, :3], air_c=air_c)
