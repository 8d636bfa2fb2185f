"""Runs of an investigation on a bench: its campaign and its blocks, on one clock.

Each run ends in the station's safe state, and each block begins from there, on a real or an emulated bench:
the chamber returns to the temperature of the last dwell, and the unit is switched off and on, so that its
time since power-on is known. An emulated bench exists as long as its clock, so that its temperatures
continue.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, read_dwells
from gyrobench.bench.closure.campaign import Campaign, campaign_of
from gyrobench.bench.closure.inputs import joined_rows, read_campaign, temperature_record
from gyrobench.bench.closure.loadable_model import model_with_effects
from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.closure.plausibility import implausible
from gyrobench.bench.closure.temperature_record import TemperatureRecord
from gyrobench.bench.engine.job import Job, emulation_of, prepare_job, read_job
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.operator import Operator
from gyrobench.bench.engine.run import EarlierRuns, is_complete, run_or_resume
from gyrobench.bench.engine.run_outcome import RunOutcome
from gyrobench.bench.engine.verification_runs import VerificationRuns, is_run_of
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.clock import RESUME_STEP_S, Clock, VirtualClock, WallClock
from gyrobench.bench.foundations.documents import Document, read_document
from gyrobench.bench.foundations.errors import DocumentError, GyrobenchError, RunFolderError
from gyrobench.bench.foundations.files import make_folder, write_whole
from gyrobench.bench.foundations.shipped import world_for
from gyrobench.bench.investigation.block_procedure import (
    SHORTLY_S,
    DwellPattern,
    block_procedure,
    opening_procedure,
)
from gyrobench.bench.investigation.blocks import Block, BlockStart, BlockTimes
from gyrobench.bench.investigation.external_bench import BlockPlan, PowerStep, StartState
from gyrobench.bench.investigation.profile import Profile
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.procedure.procedure_file import checked_procedure
from gyrobench.bench.runs.folder import RUNS, RunFolder
from gyrobench.bench.runs.journal import facts_of, read_journal
from gyrobench.bench.runs.provenance import started_utc
from gyrobench.bench.runs.telemetry import last_reading_s, read_telemetry
from gyrobench.bench.station.instruments import Emulation
from gyrobench.bench.verification.compensation_verification import DECLARED, EFFECT, NONE, VerificationResult

#: Observer and operator of a run.
Observe = Callable[[Job], AbstractContextManager[tuple[RunObserver, Operator]]]


def measure_campaign(job: Job, folder: RunFolder, observe: Observe) -> Clock | None:
    """Run the first campaign of an investigation, or finish its run in the folder.

    Returns the clock of a new run, on which blocks can follow. Raises RunFolderError if the folder holds
    another run, and GyrobenchError if the run does not finish; a later call resumes it.
    """
    if folder.journal.exists():
        if not is_run_of(folder, job):
            raise RunFolderError(f"{folder.path}: holds the run of another procedure. Choose another --out")
        _measure(job, folder, observe, None)
        return None
    clock = job.station.new_clock()
    _measure(job, folder, observe, EarlierRuns(clock, "", 0))
    return clock


@dataclass(frozen=True)
class InvestigationStart:
    """Start conditions of an investigation on a station."""

    job: Job
    folder: Path  #: Folder of the investigation.
    runs: Sequence[Path]  #: Run folders of the first table.
    profile: Profile | None = None  #: Profile of an adaptive campaign, which measures its first dwells.

    @property
    def is_measured_first(self) -> bool:
        """Whether the first table is a campaign of the investigation."""
        return list(self.runs) == [self.folder / "campaign"]


def start_with_runs(
    runs: Sequence[Path], station: str | None, world: str | None, seed: int | None, out: Path | None
) -> InvestigationStart:
    """Begin with runs of one unit.

    Arguments that are None are those of the first run; ``out`` is by default the folder ``investigation`` in
    it. Another station gets the shipped world of its name, if there is one. Raises DocumentError or
    RunFolderError if a file of the first run, or the station, can't be used.
    """
    first = RunFolder(runs[0])
    emulation_of_first = emulation_of(first)
    job = read_job(first) if station is None else prepare_job(str(first.procedure), station)
    if station is not None:
        first_station, name = read_document(first.station).data, job.station.file.station
        if not isinstance(first_station, dict) or first_station.get("station") != name:
            world = world_for(name, world, emulation_of_first.world)
    emulation = Emulation(
        world or emulation_of_first.world,
        emulation_of_first.seed if seed is None else seed,
        emulation_of_first.faults,
    )
    return InvestigationStart(replace(job, emulation=emulation), out or first.path / "investigation", runs)


def start_with_procedure(
    procedure: str, station: str, emulation: Emulation, out: Path | None, *, adaptive: bool
) -> InvestigationStart:
    """Begin with a campaign to be measured: the procedure, or only its first dwells if ``adaptive``.

    ``out``: folder of the investigation, by default under ``runs/``. Raises DocumentError if procedure or
    station are wrong, and RunFolderError if the folder can't be written.
    """
    job = prepare_job(procedure, station, emulation)
    folder = out or RUNS / f"investigation_{job.plan.procedure.procedure}"
    profile = Profile.of(job.plan) if adaptive else None
    if profile is not None:
        path = folder / "opening.yaml"
        make_folder(folder)
        write_whole(path, opening_procedure(profile, DwellPattern.of(job.plan)).encode())
        job = prepare_job(str(path), str(job.station.path), job.emulation, compensation=job.compensation)
    return InvestigationStart(job, folder, [folder / "campaign"], profile)


def verification_runs(
    campaign: RunFolder, closure: Closure, procedure: str, job: Job, folder: Path
) -> VerificationRuns:
    """Runs that compare the compensation for effects with the declared model, or the latter with none.

    Raises DocumentError as :class:`gyrobench.bench.engine.verification_runs.VerificationRuns` does.
    """
    compared = (DECLARED, EFFECT) if model_with_effects(closure).effects else (NONE, DECLARED)
    emulation = replace(job.emulation, seed=job.emulation.seed + 1, faults="")
    station, acknowledged = str(job.station.path), job.acknowledged
    return VerificationRuns(
        campaign, closure, procedure, station, emulation, folder, compared, acknowledged=acknowledged
    )


def measure_verification(runs: VerificationRuns, observe: Observe) -> VerificationResult:
    """Measure the missing runs and compare all. Raises GyrobenchError if a run does not finish."""
    for name in runs.selected:
        if not runs.is_finished(name):
            with observe(runs.jobs[name]) as (observer, operator):
                run, outcome = runs.measure(name, observer, operator)
            _require_finished(run, outcome)
    return runs.result()


def _measure(job: Job, folder: RunFolder, observe: Observe, earlier: EarlierRuns | None) -> None:
    if is_complete(folder):
        return
    with observe(job) as (observer, operator):
        _, outcome = run_or_resume(job, folder, observer, operator, earlier)
    _require_finished(folder, outcome)


def _require_finished(folder: RunFolder, outcome: RunOutcome) -> None:
    if outcome.ended != "finished":
        raise GyrobenchError(f"{folder.path}: the run {outcome.ending}. Repeat the command to resume it")


class StationBench:
    """The bench of a station, on which an investigation measures its blocks.

    Each block has a run, in the folder ``run`` in the folder of the block. ``clock`` is that of a campaign
    just measured by this process.

    Raises DocumentError if the campaign has no dwells that blocks could repeat.
    """

    def __init__(
        self, job: Job, campaign: Sequence[Path], folder: Path, observe: Observe, clock: Clock | None = None
    ) -> None:
        self._job, self._folder, self._observe, self._clock = job, folder, observe, clock
        self._station = job.station
        self._campaign = read_campaign(*campaign)
        self._runs = [RunFolder(Path(table.name)) for table in self._campaign.tables]
        self._pattern = DwellPattern.of(read_job(self._runs[0]).plan)
        self.rows = joined_rows(self._campaign)  #: Dwells of the campaign.
        last_dwells = read_dwells(self._runs[-1].dwells)
        hours = (self.rows[-1].end_s - self.rows[0].start_s) / 3600.0
        self._times = BlockTimes.on_bench(self._station.file.unit.thermal.time_constant_s, hours)
        self._shift_s = self.rows[-1].start_s - max(row.start_s for row in last_dwells)
        #: Planned duration of the campaign with cool-downs, h.
        self.campaign_h = sum(read_job(run).plan.duration_s for run in self._runs) / 3600.0

    def campaign(self, rows: Sequence[DwellRow]) -> Campaign:
        """Dwells of the campaign and of blocks, with the temperatures between them."""
        if self._campaign.whole.record.is_of_dwells:
            return replace(campaign_of(rows), tables=self._campaign.tables)
        records = [temperature_record(read_telemetry(run.telemetry)) for run in self._blocks(rows[-1].end_s)]
        record = TemperatureRecord.joined([self._campaign.whole.record, *filter(None, records)])
        return replace(campaign_of(rows, record), tables=self._campaign.tables)

    def start(self, rows: Sequence[DwellRow]) -> BlockStart:
        """Start of a block after these dwells: the safe state, some time after the last run."""
        run = [*self._runs, *self._blocks(rows[-1].end_s)][-1]
        last_s, power_ons = self._end(rows[-1].end_s)
        now_s, safe = self._clock_after(last_s).now(), self._station.file.safe_state
        readings, powered = read_telemetry(run.telemetry), safe.unit == "keep"
        end_state = replace(
            self._station.bench_at_rest(),
            chamber_c=_last(readings["chamber_c"]),
            powered=powered and read_job(run).plan.steps[-1].after.powered,
            set_point_c=safe.chamber_c,
            ramp_c_per_s=self._station.file.chamber.limits.ramp_c_per_min / 60.0,
        )
        x, y, z = (
            replace(end_state, gyro_c=_last(readings[f"gyro_{axis}_c"])).passed(now_s - last_s)
            for axis in AXES
        )
        state = StartState(
            chamber_c=x.chamber_c,
            gyro_x_c=x.gyro_c,
            gyro_y_c=y.gyro_c,
            gyro_z_c=z.gyro_c,
            powered=x.powered,
            since_power_on_s=now_s - rows[-1].start_s + rows[-1].since_power_on_s,
            position=rows[-1].position,
        )
        return BlockStart(now_s, state, power_ons, self._times)

    def timed(self, block: Block) -> Block | None:
        """The block with the times of its plan on this station; None if the station can't run it."""
        off_s = [
            step.end_s - step.start_s
            for step in block.plan.steps
            if isinstance(step, PowerStep) and not step.on
        ]
        if max(off_s, default=0.0) > SHORTLY_S and self._station.file.unit.power == "always_on":
            return None
        try:
            return block_procedure(block.plan, self._pattern).timed(block, self._plan)
        except DocumentError:
            return None

    def _plan(self, document: Document, plan: BlockPlan) -> Plan:
        state, rest = plan.state, self._station.bench_at_rest()
        bench = replace(
            rest,
            chamber_c=rest.chamber_c if state.chamber_c is None else state.chamber_c,
            gyro_c=float(np.mean([state.gyro_x_c, state.gyro_y_c, state.gyro_z_c])),
        )  # with the INS off: a power-on first switches off an INS that is on
        return self._station.plan(document, checked_procedure(document), bench)

    def measure(self, plan: BlockPlan, folder: Path) -> list[DwellRow]:
        """Run a block, or finish the run in its folder; a later call resumes an interrupted run."""
        run, path = RunFolder(folder / "run"), folder / "procedure.yaml"
        write_whole(path, block_procedure(plan, self._pattern).text.encode())
        job = prepare_job(
            str(path),
            str(self._station.path),
            self._job.emulation,
            compensation=self._job.compensation,
            acknowledged=self._job.acknowledged,
        )
        last_s, power_ons = self._end(plan.start_s)
        clock = self._clock_after(max(last_s, _last_s(run)))
        _measure(job, run, self._observe, EarlierRuns(clock, plan.unit, power_ons))
        earlier_dwells = plan.next_dwell - 1
        rows = [replace(row, dwell=row.dwell + earlier_dwells) for row in read_dwells(run.dwells)]
        if problems := implausible([*self.rows, *rows]):
            raise DocumentError("\n".join(f"{run.dwells}: {each}" for each in problems))
        return sorted(rows, key=lambda row: row.start_s)

    def _blocks(self, before_s: float) -> list[RunFolder]:
        """Runs of the blocks that began before a time, in order."""
        blocks = []
        for path in self._folder.glob("block-*/run"):
            plan = BlockPlan.model_validate_json((path.parent / "plan.json").read_text(encoding="utf-8"))
            if plan.start_s < before_s and RunFolder(path).journal.exists():
                blocks.append((plan.start_s, path))
        return [RunFolder(path) for _, path in sorted(blocks)]

    def _end(self, before_s: float) -> tuple[float, int]:
        """Last record's time of the runs that began before ``before_s``, and the power-ons until then."""
        blocks = self._blocks(before_s)
        power_ons = sum(map(_power_ons, self._runs))
        last_s = _last_s(self._runs[-1]) + self._shift_s
        return max([last_s, *map(_last_s, blocks)]), max([power_ons, *map(_power_ons, blocks)])

    def _clock_after(self, last_s: float) -> Clock:
        if self._clock is None and self._station.is_virtual:
            self._clock = VirtualClock(last_s + RESUME_STEP_S)
        elif self._clock is None:
            epoch, speed = started_utc(self._runs[0]), self._station.file.speed
            self._clock = WallClock.resumed(epoch, last_s, speed)
        elif self._station.is_virtual:
            self._clock.sleep_until(last_s + RESUME_STEP_S)
        return self._clock


def _last_s(run: RunFolder) -> float:
    """Time of the last record of a run; zero without one."""
    if not run.journal.exists():
        return 0.0
    return max(facts_of(read_journal(run.journal)).last_s, last_reading_s(run.telemetry))


def _power_ons(run: RunFolder) -> int:
    entries = read_journal(run.journal)
    return max((entry["run"] for entry in entries if entry["event"] == "powered_on"), default=0)


def _last(readings: FloatArray) -> float:
    valid = readings[np.isfinite(readings)]
    return float(valid[-1]) if len(valid) else math.nan
