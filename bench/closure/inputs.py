"""What a search reads: dwells of run folders and tables, and their temperatures."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, read_dwells
from gyrobench.bench.closure.campaign import Campaign, Table, campaign_of
from gyrobench.bench.closure.joined_tables import TableToJoin, join_tables
from gyrobench.bench.closure.quantity import GYRO_BIAS, Quantity
from gyrobench.bench.closure.temperature_record import TemperatureRecord
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import AXES, POSITIONS
from gyrobench.bench.procedure.plan import DwellPurpose
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.marks import purpose_of
from gyrobench.bench.runs.provenance import read_provenance, started_utc
from gyrobench.bench.runs.tables.coefficient_table import PlateauCoefficientRow, read_coefficients_apart
from gyrobench.bench.runs.telemetry import read_telemetry

_MIN_SAMPLES = 2
_STEP_S = 30.0
_MAX_STEPS = 20_000


def read_campaign(*paths: Path, quantity: Quantity = GYRO_BIAS) -> Campaign:
    """Read the dwells of tables and runs of one unit, of runs with the temperatures between dwells too.

    ``paths``: dwell tables or run folders, at least one; several are joined on one time axis, see
    :func:`~.joined_tables.join_tables`. ``quantity``: the coefficients to take in the place of the gyro
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
    record, began_s = None, None
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
    try:
        rows, quantity = _rows_of(read_dwells(table), quantity, path if is_run else None)
        if record is not None:
            record = replace(record, gyro_c=record.gyro_c[:, quantity.sensors])
        return TableToJoin(str(path), campaign_of(rows, record, quantity), is_run, began_s)
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
