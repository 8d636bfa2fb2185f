"""The Python interface: runs as pandas tables, a bias from arrays, the search for effects, figures.

``import gyrobench`` offers these names and loads nothing until one is used. Tables are pandas DataFrames
whose ``attrs["units"]`` gives the unit of each column; they need ``pip install 'gyrobench[pandas]'``.
"""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from gyrobench.bench.bias.bias_filter import StateSpaceEstimate, estimate_state_space
from gyrobench.bench.bias.dwell import MIN_EPOCHS, Dwell, NavigationWindow, RestOutput, TurnPath
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.parameters import ErrorModel, PriorKnowledge
from gyrobench.bench.dwells.output_checks import rounding
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.csv_tables import read_text
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError
from gyrobench.bench.foundations.packages import require
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.runs.folder import RunFolder, open_run_folder

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from gyrobench.bench.closure.outcome import Closure
    from gyrobench.bench.engine.observers import RunObserver
    from gyrobench.bench.engine.operator import Operator
    from gyrobench.bench.engine.run_outcome import FailOn
    from gyrobench.drivers.frames import FrameBlock
    from gyrobench.drivers.ins.navigation_data import NavigationData

__all__ = ["Run", "close_loop", "estimate_bias", "open_run", "run"]

#: Largest deviation of an attitude times its transpose from one; rounding to four digits is below it.
_MAX_ROTATION_ERROR = 1e-3


class Run:
    """One execution of a procedure, read from its folder; also while it is under way.

    Parameters
    ----------
    path : str or Path
        The run folder.

    Raises
    ------
    RunFolderError
        There is no run folder at that path.
    """

    def __init__(self, path: str | Path) -> None:
        self.folder: RunFolder = open_run_folder(Path(path))

    def __repr__(self) -> str:
        return f"Run({str(self.folder.path)!r})"

    @property
    def path(self) -> Path:
        """The run folder."""
        return self.folder.path

    @cached_property
    def dwells(self) -> pd.DataFrame:
        """One row per dwell, as in ``dwells.csv``."""
        return _csv_frame(self.folder.dwells)

    @cached_property
    def bias_bins(self) -> pd.DataFrame:
        """Bias per gyro, position and temperature bin, as in ``bias_bins.csv``."""
        return _csv_frame(self.folder.bias_bins)

    @cached_property
    def budget(self) -> pd.DataFrame:
        """Uncertainty budget of each dwell and bin, as in ``budget.csv``."""
        return _csv_frame(self.folder.budget)

    @cached_property
    def characteristics(self) -> pd.DataFrame:
        """Coefficients of the procedure's tests: test, gyro, name, unit, value and 95 % interval.

        Empty if the procedure has none. Raises DocumentError if their file can't be used.
        """
        from gyrobench.bench.characteristics.results import Coefficient, read_characteristics

        path = self.folder.characteristics
        rows = [
            {"test": result.test, **each.model_dump()}
            for result in (read_characteristics(path) if path.exists() else [])
            for each in result.coefficients
        ]
        frame: pd.DataFrame = _pandas().DataFrame(rows, columns=["test", *Coefficient.model_fields])
        return frame.astype(dict.fromkeys(("value", "low", "high"), float))

    @cached_property
    def coefficients(self) -> pd.DataFrame:
        """Coefficients of the sensors at each plateau, as in ``coefficients.csv``."""
        return _csv_frame(self.folder.coefficients)

    @cached_property
    def correlations(self) -> pd.DataFrame:
        """Correlations of the coefficients of each plateau, as in ``correlations.csv``."""
        return _csv_frame(self.folder.correlations)

    @cached_property
    def telemetry(self) -> pd.DataFrame:
        """Readings of table, chamber and INS; a row of NaN stands where readings are missing."""
        from gyrobench.bench.runs.telemetry import read_telemetry

        return _frame(read_telemetry(self.folder.telemetry))

    def frames(self, dwell: int) -> pd.DataFrame:
        """CAN frames of a dwell: ``timestamp_s``, ``arbitration_id``, ``length`` and ``data`` (bytes).

        Raises
        ------
        RunFolderError
            The run has no finished dwell of that number, or its frames can't be read.
        """
        block = self._block(dwell)
        data = [row[:length].tobytes() for row, length in zip(block.data, block.length, strict=True)]
        columns = {"timestamp_s": block.timestamp_s, "arbitration_id": block.arbitration_id}
        return _frame({**columns, "length": block.length, "data": data})

    def navigation(self, dwell: int) -> NavigationData:
        """Decoded output of the INS in a dwell: times, velocity ENU, attitude ``C_nb``, temperatures.

        Raises
        ------
        RunFolderError
            As :meth:`frames`.
        DocumentError
            The station or DBC file of the run is wrong.
        """
        from gyrobench.bench.dwells.measurement_setup import measurement_setup
        from gyrobench.bench.station.station import Station

        return measurement_setup(Station(self.folder.station)).decode(self._block(dwell))

    def windows_s(self, dwell: int) -> list[tuple[float, float]]:
        """First and last time of each window at rest of a dwell, on the clock of the INS.

        Raises
        ------
        RunFolderError, DocumentError
            As :meth:`navigation`.
        """
        from gyrobench.bench.dwells.run_dwells import finished_marks

        navigation = self.navigation(dwell)
        [marks] = [each for each in finished_marks(self.folder) if each.dwell == dwell][-1:]
        times_s = [
            navigation.ins_time_s[navigation.between(w.first_frame, w.end_frame)] for w in marks.windows
        ]
        return [(each_s[0], each_s[-1]) for each_s in times_s]

    def figures(self) -> dict[str, Figure]:
        """Figures of the report by name: temperature, bias of each gyro, differences between positions."""
        from gyrobench.bench.report.run_content import read_run
        from gyrobench.bench.report.run_report import figures_of

        return {name: draw() for name, draw in figures_of(read_run(self.folder))}

    def _block(self, dwell: int) -> FrameBlock:
        from gyrobench.bench.dwells.run_dwells import read_dwell_frames

        return read_dwell_frames(self.folder, dwell)


def open_run(path: str | Path) -> Run:
    """Open a run folder; raises as :class:`Run`."""
    return Run(path)


def run(
    procedure: str,
    station: str = "emulated",
    *,
    world: str | None = None,
    seed: int = 0,
    faults: str = "",
    out: str | Path | None = None,
    operator: Operator | None = None,
    observer: RunObserver | None = None,
    fail_on: FailOn | None = None,
    acknowledged: Sequence[str] = (),
) -> Run:
    """Run a procedure, as ``gyrobench run`` does.

    Parameters
    ----------
    procedure, station : str
        Files by path, or shipped ones by name.
    world : str, optional
        That of emulated instruments, likewise; by default the shipped one with the name of the station.
    seed : int
        Of the emulated instruments' noise.
    faults : str, optional
        Faults of the emulated instruments: a file by path, or a shipped one by name.
    out : str or Path, optional
        The run folder, absent or empty; by default a new one under ``runs/``.
    operator : Operator, optional
        Who answers questions. On virtual time the first answer is taken by default; on a real bench it
        has to be given.
    observer : optional
        Who watches the run.
    fail_on : {"rejected", "flagged"}, optional
        Raise if the unit is rejected; with "flagged" also if a dwell has flags or was skipped.
    acknowledged : sequence of str
        Instruments that are used although their calibration is past due, in the operator's name.

    Raises
    ------
    DocumentError
        A file is wrong, or a bench in real time has no operator.
    InstrumentError, BenchInUseError, RunFolderError
        The run can't begin.
    MeasurementError
        The run ended before its procedure did, or is what ``fail_on`` says; what it measured is in the run
        folder.
    """
    from gyrobench.bench.engine.job import prepare_job
    from gyrobench.bench.engine.observers import RunObserver
    from gyrobench.bench.engine.operator import ConsentingOperator
    from gyrobench.bench.engine.run import run_job
    from gyrobench.bench.station.instruments import Emulation

    if seed < 0:
        raise DocumentError(f"seed must not be negative; found {seed}")
    emulation = Emulation.of(station, world, seed, faults)
    job = prepare_job(procedure, station, emulation, acknowledged=acknowledged)
    if operator is None:
        if not job.is_virtual:
            raise DocumentError(
                f"{station}: this bench works in real time. Pass operator= to answer its questions"
            )
        operator = ConsentingOperator()
    folder, outcome = run_job(job, None if out is None else Path(out), observer or RunObserver(), operator)
    if outcome.ended != "finished":
        raise MeasurementError(f"{folder.path}: the run {outcome.ending}")
    if shortcoming := outcome.shortcoming(fail_on):
        raise MeasurementError(f"{folder.path}: {shortcoming}")
    return Run(folder.path)


def estimate_bias(
    times_s: ArrayLike,
    velocity_enu_mps: ArrayLike,
    attitude: ArrayLike,
    *,
    windows_s: Sequence[tuple[float, float]],
    position: str,
    latitude_deg: float,
    arw_deg_per_sqrt_h: float,
    vrw_ug_per_sqrt_hz: float = 0.0,
    velocity_lsb_mps: float = 0.0,
    heading_lsb_rad: float = 0.0,
    height_m: float = 0.0,
    azimuth_deg: float = 0.0,
    case_c: ArrayLike | None = None,
    prior: PriorKnowledge | None = None,
) -> StateSpaceEstimate:
    """Estimate the gyro biases of one dwell from the navigation output of an INS.

    Parameters
    ----------
    times_s : array_like, shape (n,)
        Time of each epoch, increasing; from one self-alignment, without another in between.
    velocity_enu_mps : array_like, shape (n, 3)
        Velocity East, North, Up; Up is not used and may be NaN.
    attitude : array_like, shape (n, 3, 3)
        ``C_nb``: turns a vector of the body frame into East-North-Up.
    windows_s : sequence of (float, float)
        First and last time of each window at rest; between two of them the unit is turned about the vertical.
    position : str
        ``z_up``, ``z_down``, ``y_up``, ``y_down``, ``x_up`` or ``x_down``.
    latitude_deg, height_m : float
        Where the bench stands.
    arw_deg_per_sqrt_h, vrw_ug_per_sqrt_hz, velocity_lsb_mps, heading_lsb_rad : float
        Noise and output resolution of the INS.
    azimuth_deg : float
        Azimuth of the position in the first window.
    case_c : array_like, shape (n,), optional
        Temperature of the case, degC. Without it the uncertainty leaves out accelerometers that follow it.
    prior : PriorKnowledge, optional
        Standard uncertainties of accelerometers, scale factors and misalignments.

    Returns
    -------
    StateSpaceEstimate
        ``bias_dph`` and ``sigma_dph``, shape (3,), ``covariance``, and the test of the fit.

    Raises
    ------
    MeasurementError
        The data can't be used: the message says which and why.
    """
    numbers: dict[str, Any] = {
        "latitude_deg": latitude_deg,
        "height_m": height_m,
        "azimuth_deg": azimuth_deg,
        "arw_deg_per_sqrt_h": arw_deg_per_sqrt_h,
        "vrw_ug_per_sqrt_hz": vrw_ug_per_sqrt_hz,
        "velocity_lsb_mps": velocity_lsb_mps,
        "heading_lsb_rad": heading_lsb_rad,
    }
    for name, value in numbers.items():
        if not (isinstance(value, Real) and math.isfinite(value)):
            raise MeasurementError(f"{name} must be a finite number; found {value!r}")
    lsb = (velocity_lsb_mps, heading_lsb_rad)
    if min(arw_deg_per_sqrt_h, vrw_ug_per_sqrt_hz, *lsb) < 0:
        raise MeasurementError("noise and output resolution of the INS must not be negative")
    if position not in POSITIONS:
        raise MeasurementError(f"there is no position '{position}'; the positions are {', '.join(POSITIONS)}")
    output = _output(times_s, velocity_enu_mps, attitude, case_c)
    windows, turns = _windows_and_turns(output, windows_s)
    at_rest: tuple[FloatArray, ...] = tuple(window.C_nb[0] for window in windows)
    dwell = Dwell(position, float(np.deg2rad(azimuth_deg)), windows, at_rest, turns)
    noise = NoiseModel.from_datasheet(arw_deg_per_sqrt_h, vrw_ug_per_sqrt_hz, *lsb).at_least(
        *rounding(windows, *lsb)
    )
    site = Site(float(np.deg2rad(latitude_deg)), height_m)
    return estimate_state_space(dwell, ErrorModel(site, noise, prior or PriorKnowledge()))


def _output(
    times_s: ArrayLike, velocity_enu_mps: ArrayLike, attitude: ArrayLike, case_c: ArrayLike | None
) -> RestOutput:
    """Navigation output of all windows and the turns between them; raises MeasurementError."""
    time = _numbers(times_s, "times_s")
    velocity = _numbers(velocity_enu_mps, "velocity_enu_mps")
    C_nb = _numbers(attitude, "attitude")
    if C_nb.shape != (time.size, 3, 3) or velocity.shape != (time.size, 3) or time.ndim != 1:
        raise MeasurementError(
            f"times {time.shape}, velocities {velocity.shape} and attitudes {C_nb.shape} "
            "do not fit together; each epoch needs a time, three velocities and a 3 by 3 attitude"
        )
    if not np.all(np.isfinite(time)) or np.any(np.diff(time) < 0):
        raise MeasurementError("times_s must be finite and increase from epoch to epoch")
    _check_rotations(C_nb)
    velocity[:, 2] = 0.0
    temperature = None if case_c is None else _numbers(case_c, "case_c")
    if temperature is not None and temperature.shape != time.shape:
        raise MeasurementError(f"{time.size} times with case temperatures {temperature.shape}; each has one")
    return RestOutput(time, velocity, C_nb, accelerometer_c=temperature)


def _check_rotations(C_nb: FloatArray) -> None:
    """Raise MeasurementError if a matrix is no rotation; NaN is checked with the windows."""
    with np.errstate(invalid="ignore"):
        deviation = np.abs(C_nb @ C_nb.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        wrong = np.flatnonzero((deviation > _MAX_ROTATION_ERROR) | (np.linalg.det(C_nb) < 0))
    if wrong.size:
        raise MeasurementError(
            f"attitude is no rotation matrix in row {wrong[0]}: rows and columns must be orthogonal unit "
            "vectors, right-handed. Check scale, signs and order of its elements"
        )


def _windows_and_turns(
    output: RestOutput, windows_s: Sequence[tuple[float, float]]
) -> tuple[tuple[NavigationWindow, ...], tuple[TurnPath, ...]]:
    """The output in each window, and the attitude from each window to the next; raises MeasurementError."""
    bounds_s = _numbers(windows_s, "windows_s")
    if bounds_s.ndim != 2 or bounds_s.shape[1] != 2 or not np.all(bounds_s[:, 0] < bounds_s[:, 1]):
        raise MeasurementError("windows_s must be pairs of first and last time, the first before the last")
    time, C_nb, temperature = output.time_s, output.C_nb, output.accelerometer_c
    spans = [
        (int(np.searchsorted(time, first)), int(np.searchsorted(time, last, "right")))
        for first, last in bounds_s
    ]
    for (first, last), (a, b) in zip(bounds_s, spans, strict=True):
        if b - a < MIN_EPOCHS:
            times = f"times_s is from {time[0]:g} to {time[-1]:g} s" if time.size else "times_s is empty"
            raise MeasurementError(
                f"the window from {first:g} to {last:g} s has {counted(b - a, 'epoch')}, required: "
                f"{MIN_EPOCHS}; {times}. Give both in seconds on the same clock"
            )
    windows = tuple(
        NavigationWindow(
            time[a:b],
            output.velocity_enu_mps[a:b],
            C_nb[a:b],
            accelerometer_c=None if temperature is None else temperature[a:b],
        )
        for a, b in spans
    )
    turns = tuple(
        TurnPath(time[end - 1 : begin + 1], C_nb[end - 1 : begin + 1])
        for (_, end), (begin, _) in itertools.pairwise(spans)
    )
    return windows, turns


def close_loop(
    table: str | Path | pd.DataFrame | Sequence[str | Path],
    hold_out_cycles: Sequence[int] = (),
    *,
    rotate: bool = False,
) -> Closure:
    """Search for the effects that the declared bias model lacks.

    Parameters
    ----------
    table : str, Path, DataFrame or sequence of str or Path
        A dwell table, or a run folder, or several of one unit; a DataFrame has the columns of ``dwells.csv``.
    hold_out_cycles : sequence of int
        Cycles that the search does not see; by default the last one, of several tables that of the first
        table with several cycles. Numbers of several tables are those in ``Closure.campaign.tables``.
    rotate : bool
        Whether each cycle is held out in turn as well: ``Closure.held_out_in_turn``.

    Returns
    -------
    Closure
        ``verdict``, ``names`` of the effects found and their ``probability``; ``effects`` with values and
        sizes; ``error_before_dph`` and ``error_after_dph`` in the held-out cycle; ``evidence`` for each
        candidate alone.

    Raises
    ------
    DocumentError, MeasurementError
        The tables can't be used.
    """
    from gyrobench.bench.bias.dwell_table import parse_dwells
    from gyrobench.bench.closure.campaign import campaign_of
    from gyrobench.bench.closure.inputs import read_campaign
    from gyrobench.bench.closure.loop import close_loop as search
    from gyrobench.bench.closure.loop import hold_out_each

    if isinstance(table, (str, Path)):
        campaign = read_campaign(Path(table))
    elif not (table if isinstance(table, Sequence) else hasattr(table, "to_csv")):
        raise DocumentError(
            f"the search takes a dwell table, a run folder or a DataFrame, or several files; found {table!r}"
        )
    elif isinstance(table, Sequence):
        campaign = read_campaign(*map(Path, table))
    else:
        campaign = campaign_of(parse_dwells(table.to_csv(index=False), "the DataFrame"))
    closure = search(campaign, hold_out_cycles)
    return hold_out_each(closure) if rotate else closure


def _numbers(values: ArrayLike, what: str) -> FloatArray:
    """A copy as array of float.

    Raises
    ------
    MeasurementError
        It is not one.
    """
    try:
        return np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        raise MeasurementError(f"{what} is not an array of numbers: {error}") from error


def _csv_frame(path: Path) -> pd.DataFrame:
    """A table of the run; text stays text, everything else is a number or NaN."""
    from gyrobench.bench.exchange.export_folder import type_of

    pandas = _pandas()
    text = read_text(path)
    columns = text.partition("\n")[0].strip().split(",")
    texts = [name for name in columns if str(type_of(name)) == "string"]
    frame = pandas.read_csv(io.StringIO(text), dtype=dict.fromkeys(texts, str))
    frame[texts] = frame[texts].fillna("")
    return _with_units(frame)


def _frame(columns: Mapping[str, Any]) -> pd.DataFrame:
    return _with_units(_pandas().DataFrame(dict(columns)))


def _with_units(frame: pd.DataFrame) -> pd.DataFrame:
    from gyrobench.bench.exchange.export_folder import unit_of

    frame.attrs["units"] = {name: unit for name in frame.columns if (unit := unit_of(name))}
    return frame


def _pandas() -> Any:
    return require("pandas")
