"""What a search reads: dwells of run folders and tables, joined on one time axis, and their temperatures."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, read_dwells
from gyrobench.bench.closure.campaign import Campaign, Table, campaign_of
from gyrobench.bench.closure.quantity import GYRO_BIAS, Quantity
from gyrobench.bench.closure.temperature_record import TemperatureRecord
from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import AXES, POSITIONS
from gyrobench.bench.procedure.plan import DwellPurpose
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.marks import purpose_of
from gyrobench.bench.runs.provenance import ins_identity, read_provenance, started_utc
from gyrobench.bench.runs.tables.coefficient_table import PlateauCoefficientRow, read_coefficients_apart
from gyrobench.bench.runs.telemetry import read_telemetry

_MIN_SAMPLES = 2
_STEP_S = 30.0
_MAX_STEPS = 20_000
#: Time from the end of a table to the power-on of the next one where no common clock is known.
ASSUMED_PAUSE_S = 3600.0
_SAME_S = 1.0
_ON_CLOCK = "on the clock of "


def read_campaign(*paths: Path, quantity: Quantity = GYRO_BIAS) -> Campaign:
    """Read the dwells of tables and runs of one unit, of runs with the temperatures between dwells too.

    ``paths``: dwell tables or run folders, at least one; several are joined on one time axis, see
    :func:`join_tables`. ``quantity``: the coefficients to take in the place of the gyro
    biases, from the columns :func:`coefficient_columns`. Raises DocumentError if there is no dwell table, or
    it is wrong. Raises RunFolderError if a folder is not a run folder, or its telemetry can't be read. Raises
    MeasurementError if there are no good dwells, dwells of several units, or tables that can't be joined.
    """
    sources = [_source(path, quantity) for path in paths]
    if len(sources) > 1:
        return join_tables(sources)
    [source] = sources
    cycles = tuple(np.unique(source.campaign.whole.cycle).tolist())
    table = Table(source.name, cycles)
    campaign = replace(source.campaign.whole, tables=(table,))
    return campaign if source.campaign.part_of is None else campaign.part(source.campaign.part_of[1])


def _source(path: Path, quantity: Quantity) -> TableToJoin:
    record, began_s, ins = None, None, ""
    table, is_run = path, path.is_dir()
    if is_run:
        folder = open_run_folder(path)
        table = folder.dwells
        if not table.exists():
            advice = _advice_without_dwells(folder)
            raise MeasurementError(f"{path}: no dwell was finished in this run: nothing to search. {advice}")
        record = temperature_record(read_telemetry(folder.telemetry))
        provenance = read_provenance(folder)
        if "started_utc" in provenance and provenance.get("options", {}).get("clock") != "virtual":
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
    """Rows with the coefficients searched in the place of the biases, NaN where one was not measured.

    Without columns for them they are those of the plateaus of a run, in place of its dwells; the biases of
    the accelerometers are those of the dwells, less the vertical ones, which a dwell does not determine.
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
        known = read_coefficients_apart(RunFolder(run).coefficients, RunFolder(run).budget)
        return _plateau_rows(rows, known, quantity), replace(quantity, row="plateau")
    else:
        raise MeasurementError(
            f"has no columns {columns[0][0]}, {columns[0][1]}, ... Search a table with the coefficients of "
            "each dwell"
        )
    pairs = zip(rows, values, strict=True)
    return [_with_values(row, its, quantity.sensors) for row, its in pairs], quantity


def _plateau_rows(
    rows: Sequence[DwellRow], coefficients: Sequence[PlateauCoefficientRow], quantity: Quantity
) -> list[DwellRow]:
    """One row for each plateau with rotations and dwells: times of these, coefficients of the plateau.

    All get one position, since the coefficients of a plateau are those of all. Visits to a set point in the
    same cycle are taken in the order of time. Raises MeasurementError if no plateau has rotations.
    """
    plateaus: dict[int, dict[str, PlateauCoefficientRow]] = {}
    for each in coefficients:
        plateaus.setdefault(each.plateau, {})[f"{each.coefficient}_{each.axis}"] = each
    turned = [
        known
        for known in plateaus.values()
        if np.isfinite([row.gyro_rate_c_per_h for row in known.values()]).any()
    ]
    if not turned:
        raise MeasurementError(
            f"{quantity.name} needs rotations, and the run has none that could be evaluated. Use a procedure "
            "with rotate and spin, such as full_calibration"
        )
    good = [row for row in rows if not row.flags]
    visits: dict[tuple[int, str], list[list[DwellRow]]] = {}
    for place, group in itertools.groupby(good, _place):
        visits.setdefault(place, []).append(list(group))
    found = []
    for known in turned:
        if visit := visits.get(_place(next(iter(known.values())))):
            dwells = visit.pop(0)
            mean: dict[str, Any] = {
                name: tuple(np.mean([getattr(row, name) for row in dwells], axis=0).tolist())
                for name in ("gyro_rate_c_per_h", "board_c")
            }
            biases = [known[f"gyro_bias_{axis}"] for axis in AXES]
            mean["gyro_c"] = tuple(each.temperature_c for each in biases)
            if np.isfinite([each.gyro_rate_c_per_h for each in biases]).all():
                mean["gyro_rate_c_per_h"] = tuple(each.gyro_rate_c_per_h for each in biases)
            whole = replace(dwells[0], end_s=dwells[-1].end_s, position=rows[0].position, **mean)
            pairs = [(known[name].value, known[name].sigma) for name in quantity.coefficients]
            found.append(_with_values(whole, np.array(pairs), quantity.sensors))
    return found


def _place(each: DwellRow | PlateauCoefficientRow) -> tuple[int, str]:
    """Cycle and set point, NaN too, as one key."""
    return each.cycle, f"{each.chamber_set_c:z.2f}"


def _with_values(row: DwellRow, pairs: FloatArray, sensors: Sequence[int]) -> DwellRow:
    """Row with values and uncertainties (3, 2) of sensors in the place of the biases."""
    triples: dict[str, Any] = {
        name: tuple(getattr(row, name)[each] for each in sensors)
        for name in ("gyro_c", "gyro_rate_c_per_h", "board_c")
    }
    triples |= {"bias_dph": tuple(pairs[:, 0].tolist()), "sigma_dph": tuple(pairs[:, 1].tolist())}
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
        """Whether this is a table that continues another one on the same clock."""
        same = {self.campaign.whole.run_names[0]} & set(other.campaign.whole.run_names)
        known_s = other.campaign.power_on_s if same else np.empty(0)
        is_same_power_cycle = np.any(np.abs(known_s - self.power_on_s) <= _SAME_S)
        begins = is_same_power_cycle or self.power_on_s >= other.end_s - _SAME_S
        return not self.is_run and self.start_s >= other.end_s - 1e-3 and bool(begins)


def join_tables(sources: Sequence[TableToJoin]) -> Campaign:
    """Join tables of one unit on one time axis, with unique numbers of dwells and cycles.

    Runs with a calendar time are placed by it. A table that continues the one before on its clock stays
    there; another one is placed after the one before, :data:`ASSUMED_PAUSE_S` before its power-on.

    Raises MeasurementError if they are of several units, overlap in time, or have dwells in common.
    """
    sources = _ordered(sources)
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
        shift_s, placed = _placed(each, sources[:index], shifts_s)
        part = _shifted(each, shift_s, parts, is_on_clock=placed.startswith(_ON_CLOCK))
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
    return _together(parts, tables)


def _doubt(source: TableToJoin, first: TableToJoin) -> str:
    """Why a table may be of another unit or firmware than the first; empty if of the same."""
    if source.ins and first.ins and source.ins != first.ins:
        return f"its INS identifies as {source.ins}, that of {first.name} as {first.ins}"
    if source.campaign.reported_unit:
        return ""
    return f"without a serial number: taken for the unit of {first.name}"


def _ordered(sources: Sequence[TableToJoin]) -> list[TableToJoin]:
    """Sources in the order of time if that is known, otherwise as given."""
    began_s = [each.began_s for each in sources if each.began_s is not None]
    if len(began_s) == len(sources):
        return [sources[index] for index in np.argsort(began_s, kind="stable")]
    in_time = sorted(sources, key=lambda each: each.start_s)
    return in_time if all(later.is_after(each) for each, later in pairwise(in_time)) else list(sources)


def _placed(
    source: TableToJoin, before: Sequence[TableToJoin], shifts_s: Sequence[float]
) -> tuple[float, str]:
    """What is added to the times of a source, and how that was found."""
    if not before:
        return 0.0, ""
    for other in before:
        mine, theirs = source.campaign.whole.bias_dph, other.campaign.whole.bias_dph
        common = np.flatnonzero((mine[:, np.newaxis] == theirs).all(axis=2).any(axis=1))
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


def _shifted(
    source: TableToJoin, shift_s: float, before: Sequence[Campaign], *, is_on_clock: bool
) -> Campaign:
    """Campaign on the common clock, with numbers of dwells and cycles and runs that those before lack."""
    campaign = source.campaign
    whole = campaign.whole
    names: list[str] = list(before[-1].run_names) if before else []
    known_s = np.concatenate([each.power_on_s for each in before]) if before else np.empty(0)
    runs = []
    for index, name in enumerate(whole.run_names):
        on_s = shift_s + float((whole.start_s - whole.since_power_on_s)[whole.run == index].min())
        if name in names and not np.any(np.abs(known_s - on_s) <= _SAME_S):
            name = f"{name} ({source.name})"
        names += [] if name in names else [name]
        runs.append(names.index(name))

    last_cycle = _highest([each.whole.cycle for each in before])
    continues_cycle = is_on_clock and whole.cycle.min() == last_cycle
    moved = replace(
        whole,
        run_names=tuple(names),
        run=np.array(runs)[whole.run],
        dwell=_above(_highest([each.whole.dwell for each in before]), whole.dwell),
        cycle=whole.cycle if continues_cycle else _above(last_cycle, whole.cycle),
        start_s=whole.start_s + shift_s,
        end_s=whole.end_s + shift_s,
        record=replace(whole.record, time_s=whole.record.time_s + shift_s),
    )
    return moved if campaign.part_of is None else moved.part(campaign.part_of[1])


def _highest(used: Sequence[IntArray]) -> float:
    return max((float(each.max()) for each in used), default=-np.inf)


def _above(highest: float, numbers: IntArray) -> IntArray:
    """Numbers, shifted if the first is not above the highest used one."""
    first = int(numbers.min())
    return numbers if first > highest else numbers + int(highest) + 1 - first


def _together(parts: Sequence[Campaign], tables: Sequence[Table]) -> Campaign:
    wholes = [each.whole for each in parts]
    arrays: dict[str, Any] = {
        each.name: np.concatenate([getattr(whole, each.name) for whole in wholes])
        for each in fields(Campaign)
        if each.name != "azimuth_deg" and isinstance(getattr(wholes[0], each.name), np.ndarray)
    }
    together = replace(
        wholes[-1],
        **arrays,
        position=tuple(name for whole in wholes for name in whole.position),
        record=TemperatureRecord.joined([whole.record for whole in wholes]),
        azimuth_deg=np.concatenate([_known(whole, whole.azimuth_deg) for whole in wholes]),
        columns={
            name: np.concatenate([_known(whole, whole.columns.get(name)) for whole in wholes])
            for name in dict.fromkeys(name for whole in wholes for name in whole.columns)
        },
        without_temperatures=tuple(
            number + table.added
            for whole, table in zip(wholes, tables, strict=True)
            for number in whole.without_temperatures
        ),
        tables=tuple(tables),
    )
    good = np.concatenate(
        [np.ones(len(each), dtype=bool) if each.part_of is None else each.part_of[1] for each in parts]
    )
    return together if good.all() else together.part(good)


def _known(whole: Campaign, values: FloatArray | None) -> FloatArray:
    return np.full(len(whole), np.nan) if values is None else values


def joined_rows(campaign: Campaign) -> list[DwellRow]:
    """Rows of the tables of a campaign in the order of time, with its times, numbers and names of runs."""
    whole, rows = campaign.whole, list[DwellRow]()
    place = {dwell: index for index, dwell in enumerate(whole.dwell.tolist())}
    for table in campaign.tables:
        path = Path(table.name)
        own = read_dwells(open_run_folder(path).dwells if path.is_dir() else path)
        known = {row.dwell: place[row.dwell + table.added] for row in own if row.dwell + table.added in place}
        first = next(row for row in own if row.dwell in known)
        shift_s = float(whole.start_s[known[first.dwell]]) - first.start_s
        cycles = int(whole.cycle[known[first.dwell]]) - first.cycle
        names = {row.run: whole.run_names[whole.run[known[row.dwell]]] for row in own if row.dwell in known}
        rows += [
            replace(
                row,
                dwell=row.dwell + table.added,
                cycle=row.cycle + cycles,
                run=names.get(row.run, row.run),
                start_s=row.start_s + shift_s,
                end_s=row.end_s + shift_s,
            )
            for row in own
        ]
    return sorted(rows, key=lambda row: (row.start_s, row.dwell))


def temperature_record(telemetry: Mapping[str, FloatArray]) -> TemperatureRecord | None:
    """Make a record of a run's readings at equal steps; None where a gyro's temperature was not read.

    Between readings the temperature is taken as a straight line.
    """
    time_s = telemetry["time_s"]
    readings = [telemetry[f"gyro_{axis}_c"] for axis in AXES]
    readings += [telemetry["chamber_c"]] if np.isfinite(telemetry["chamber_c"]).sum() >= _MIN_SAMPLES else []
    valid = [np.isfinite(each) for each in readings]
    if any(np.count_nonzero(each) < _MIN_SAMPLES for each in valid):
        return None
    first_s, last_s = float(time_s[0]), float(time_s[-1])
    steps = min(max(round((last_s - first_s) / _STEP_S), 1), _MAX_STEPS)
    even_s = np.linspace(first_s, last_s, steps + 1)
    even_c = np.stack(
        [
            np.interp(even_s, time_s[known], values[known])
            for values, known in zip(readings, valid, strict=True)
        ],
        axis=1,
    )
    air_c = even_c[:, 3] if len(readings) > len(AXES) else None
    return TemperatureRecord(even_s, even_c[:, :3], air_c=air_c)
