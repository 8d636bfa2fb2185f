"""Runs of a verification: without compensation, with the declared model, and with the effects."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, read_dwells
from gyrobench.bench.closure.campaign import heading_numbers
from gyrobench.bench.closure.files import holds_search
from gyrobench.bench.closure.loadable_model import (
    LoadableModel,
    declared_model,
    model_with_effects,
    with_coefficients,
)
from gyrobench.bench.closure.loop import repeat_search
from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.closure.quantity import QUANTITIES
from gyrobench.bench.dwells.measure_dwell import CheckDwell, MeasuredDwell
from gyrobench.bench.dwells.measurement_setup import measurement_setup
from gyrobench.bench.dwells.run_dwells import measure_recorded
from gyrobench.bench.engine.job import Job, emulation_of, prepare_job
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.operator import Operator
from gyrobench.bench.engine.run import run_or_resume
from gyrobench.bench.engine.run_outcome import RunOutcome
from gyrobench.bench.foundations.errors import DocumentError, RunFolderError
from gyrobench.bench.foundations.text import counted, plural
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.runs.compensation_file import compensations_in_use, read_compensation
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import facts_of, read_journal
from gyrobench.bench.runs.provenance import ins_identity
from gyrobench.bench.runs.tables.coefficient_table import (
    COEFFICIENT_TABLE,
    PlateauCoefficientRow,
    plateau_findings,
    read_coefficients_for_fit,
    read_common_sigmas,
    read_correlations,
)
from gyrobench.bench.station.instruments import Emulation
from gyrobench.bench.verification.coefficient_verification import (
    CoefficientResult,
    CoefficientRun,
    compare_coefficients,
    corrections,
)
from gyrobench.bench.verification.compensation_verification import (
    DECLARED,
    EFFECT,
    IN_WORDS,
    NONE,
    MeasuredRun,
    VerificationResult,
    compare_runs,
)
from gyrobench.drivers.ins.command_map import CoefficientCommand
from gyrobench.drivers.ins.compensation import Compensation

#: Steps that measure all coefficients.
_ROTATIONS = ("rotate", "spin")


#: Dwells of a run, and its dwells that check a calibration.
_Measured = tuple[Sequence[MeasuredDwell], Sequence[CheckDwell]]


class VerificationRuns:
    """Measures with each compensation of a campaign that was searched, and compares the remaining errors.

    Each compensation has a separate run, in a folder with its name. A finished run is not repeated.
    ``closure`` is the outcome of the search in the campaign ``run``. All runs have the same world and seed.
    ``only`` limits the compensations to measure with; ``coefficients`` includes all coefficients that the
    run measured; ``acknowledged``: instruments that may be past due. Raises DocumentError if procedure or
    station are wrong, the INS does not accept a compensation, a selected compensation does not exist, or the
    campaign was measured with a compensation or with the same seed.
    """

    def __init__(
        self,
        run: RunFolder,
        closure: Closure,
        procedure: str,
        station: str,
        emulation: Emulation,
        folder: Path,
        only: Sequence[str] = (),
        *,
        coefficients: bool = False,
        acknowledged: Sequence[str] = (),
    ) -> None:
        _check_uncompensated(run)
        self.folder = folder
        self._run = run
        self._closure = closure
        self._measured: dict[str, _Measured] = {}
        self._has_coefficients = coefficients
        #: Searches in the other coefficients of the run.
        self.searches: tuple[Closure, ...] = ()
        if coefficients:
            folders = [run.closure.with_name(f"{run.closure.name}_{each.name}") for each in QUANTITIES]
            self.searches = tuple(repeat_search(each) for each in folders if holds_search(each))
        declared, with_effects = declared_model(closure), model_with_effects(closure)
        if coefficients:
            declared, with_effects = _with_coefficients(run, self.searches, declared, with_effects)
        if not with_effects.effects:
            declared = replace(declared, notes=with_effects.notes)
        models = {DECLARED: declared, **({EFFECT: with_effects} if with_effects.effects else {})}
        compensations: dict[str, Compensation | None] = {NONE: None}
        compensations |= {name: model.compensation for name, model in models.items()}
        if set(only) - compensations.keys():
            raise DocumentError(
                f"{run.path}: the search found no effect that an INS can compensate. "
                f"Leave --only {EFFECT} out"
            )
        #: Compensations to measure with.
        self.selected = [name for name in compensations if name in only or not only]
        unit = closure.campaign.reported_unit
        #: Job for each compensation that is selected or has a run already, in order.
        self.jobs: dict[str, Job] = {}
        for name, compensation in compensations.items():
            if name in self.selected or (folder / name).exists():
                job = prepare_job(
                    procedure, station, emulation, compensation=compensation, acknowledged=acknowledged
                )
                self.jobs[name] = replace(job, unit=unit)
        self._job = self.jobs[self.selected[0]]
        load = self._job.station.file.ins.commands.load_compensation
        #: Models that can be loaded; without "effect" if the search found no effect to load.
        self.models = {name: _with_limit_note(model, load) for name, model in models.items()}
        _check_other_seed(run, self._job)
        if coefficients and not any(each.step.name in _ROTATIONS for each in self._job.plan.steps):
            raise DocumentError(
                f"{procedure}: the procedure measures no coefficients. Give one with rotations, as "
                "--procedure full_calibration"
            )

    def is_finished(self, name: str) -> bool:
        """Whether the run with a compensation is finished, with the same job.

        Raises RunFolderError if its folder holds another run.
        """
        folder = RunFolder(self.folder / name)
        if name in self._measured:
            return True
        if not folder.journal.is_file():
            return False
        if not is_run_of(folder, self.jobs[name]):
            raise RunFolderError(
                f"{folder.path}: holds a run of another model, procedure or world. Remove it, or choose "
                "another --out"
            )
        return facts_of(read_journal(folder.journal)).ended == "finished"

    def measure(self, name: str, observer: RunObserver, operator: Operator) -> tuple[RunFolder, RunOutcome]:
        """Run the procedure with one compensation, or resume its run.

        Raises InstrumentError or RunFolderError as :func:`gyrobench.bench.engine.run.run_or_resume`.
        """
        run = RunFolder(self.folder / name)
        folder, outcome = run_or_resume(self.jobs[name], run, observer, operator)
        if outcome.ended == "finished":
            self._measured[name] = (outcome.dwells, outcome.check_dwells)
        return folder, outcome

    def result(self) -> VerificationResult:
        """Evaluate all finished runs. Raises RunFolderError if an earlier run can't be read."""
        measured = {
            name: self._measured.get(name)
            or measure_recorded(RunFolder(self.folder / name), measurement_setup(job.station))
            for name, job in self.jobs.items()
            if self.is_finished(name)
        }
        rows = {name: [dwell.row for dwell in dwells] for name, (dwells, _) in measured.items()}
        fitted_c = self._closure.campaign.gyro_c[self._closure.searched]
        draws = {DECLARED: self._closure.declared_draws, EFFECT: self._closure.model_draws}
        effect_names = set(self._closure.names)
        fits = {
            name: (draws[name], effect_names.intersection(model.effects))
            for name, model in self.models.items()
        }
        longest = max(rows.values(), key=len)  # a run may lack dwells
        site = self._job.station.site
        coefficients = self._coefficients(measured, site)
        return VerificationResult(
            source=str(self._run.path),
            closure=self._closure,
            models=self.models,
            results=compare_runs(
                [
                    MeasuredRun(
                        name,
                        rows[name],
                        check_dwells,
                        fits.get(name),
                        self.models[name].compensation if name in self.models else None,
                        is_limited=self.models[DECLARED].is_limited,
                    )
                    for name, (_, check_dwells) in measured.items()
                ],
                site,
                fitted_c,
            ),
            new_attitudes=_new_attitudes(read_dwells(self._run.dwells), longest),
            dwells=len(longest),
            is_same_seed=bool(self._job.emulated_world()),
            notes=tuple(self._notes(rows, has_coefficients=bool(coefficients))),
            searches=self.searches,
            coefficients=coefficients,
        )

    def _coefficients(self, measured: Iterable[str], site: Site) -> tuple[CoefficientResult, ...]:
        if not self._has_coefficients:
            return ()
        folders = {name: RunFolder(self.folder / name) for name in measured}
        runs = [
            CoefficientRun(
                name,
                _coefficients_of(run),
                read_correlations(run.correlations),
                self.models[name].compensation.coefficients if name in self.models else {},
                read_common_sigmas(run.budget),
            )
            for name, run in folders.items()
        ]
        return compare_coefficients(runs, site)

    def _notes(self, rows: Mapping[str, Sequence[DwellRow]], *, has_coefficients: bool) -> Iterator[str]:
        units = {row.unit for row in read_dwells(self._run.dwells)}
        before = ins_identity(self._run)
        for name, measured in rows.items():
            now = ins_identity(RunFolder(self.folder / name))
            if before and now not in ("", before):
                yield (
                    f"The INS identified as {before} for the model, and as {now} in the run {IN_WORDS[name]}."
                )
            other_units = {row.unit for row in measured} - units
            if other_units:
                yield (
                    f"The run {IN_WORDS[name]} measured the unit {', '.join(sorted(other_units))}, but the "
                    f"model belongs to {', '.join(sorted(units))}."
                )
            flagged = sum(bool(row.flags) for row in measured)
            if self._has_coefficients:
                findings = plateau_findings(
                    COEFFICIENT_TABLE.read(RunFolder(self.folder / name).coefficients)
                )
                yield from (f"In the run {IN_WORDS[name]}: {each}" for each in findings)
            if flagged:
                yield flags_note(name, flagged, len(measured))
        if self._has_coefficients and not has_coefficients:
            yield "No plateau has coefficients in all runs, so they are not compared."
        in_use = compensations_in_use(RunFolder(self.folder / NONE)) if NONE in rows else []
        if in_use:
            yield f"In the run {IN_WORDS[NONE]} the INS applied a stored compensation ({', '.join(in_use)})."


def flags_note(name: str, flagged: int, dwells: int) -> str:
    """Note of how many dwells of the run with a compensation have flags, at least one."""
    verbs = plural(flagged, "has flags and is", "have flags and are")
    return f"In the run {IN_WORDS[name]} {flagged} of {counted(dwells, 'dwell')} {verbs} not used."


def new_emulation(run: RunFolder, world: str | None = None, seed: int | None = None) -> Emulation:
    """World of a run with the next seed: the same unit with other noise and power-ons, without faults.

    ``world`` and ``seed`` replace those of the run.
    """
    original = emulation_of(run)
    return Emulation(world or original.world, original.seed + 1 if seed is None else seed)


def _coefficients_of(run: RunFolder) -> list[PlateauCoefficientRow]:
    """Coefficients of a run.

    Raises DocumentError if none of its rotations could be evaluated: dwells alone leave coefficients
    undetermined on which the others depend.
    """
    rows = COEFFICIENT_TABLE.read(run.coefficients) if run.coefficients.exists() else []
    if not any(np.isfinite(row.gyro_rate_c_per_h) for row in rows):
        [reason, *_] = [*plateau_findings(rows), "It has none."]
        raise DocumentError(
            f"{run.path}: no rotations of this run could be evaluated, and dwells alone do not determine the "
            f"coefficients. {reason} Measure a procedure with rotations, as full_calibration"
        )
    return rows


def _with_coefficients(
    run: RunFolder, searches: Iterable[Closure], *models: LoadableModel
) -> list[LoadableModel]:
    """Models of the gyros' biases with the other coefficients of a run.

    If a search in a coefficient found effects, its model replaces the polynomial in the second model. A
    search in a single cycle confirms no effect, and is not used.
    """
    _coefficients_of(run)  # raises for a run without rotations
    polynomials = corrections(read_coefficients_for_fit(run.coefficients, run.budget))
    closures = [each for each in searches if not each.searched.all()]
    return [
        with_coefficients(
            replace(model, compensation=replace(model.compensation, coefficients=polynomials)),
            closures,
            effects=index > 0,
        )
        for index, model in enumerate(models)
    ]


def _check_uncompensated(run: RunFolder) -> None:
    in_use = compensations_in_use(run)
    if in_use:
        raise DocumentError(
            f"{run.path}: was measured while the INS applied a stored compensation ({', '.join(in_use)}), so "
            "its model describes only the remaining biases. Clear it and measure the campaign again"
        )


def _check_other_seed(run: RunFolder, job: Job) -> None:
    if job.emulated_world() and job.has_world_of(run):
        raise DocumentError(
            f"--seed {job.emulation.seed} is the seed of {run.path}, so the noise would be the same. Choose "
            "another seed, or leave --seed out"
        )


def is_run_of(folder: RunFolder, job: Job) -> bool:
    """Whether a run has the same procedure, world and compensation as a job."""
    same_files = (folder.procedure.read_bytes(), folder.station.read_bytes()) == (
        job.document.path.read_bytes(),
        job.station.path.read_bytes(),
    )
    if not (same_files and job.has_world_of(folder)):
        return False
    if job.compensation is None or not folder.compensation.exists():
        return job.compensation is None and not folder.compensation.exists()
    return read_compensation(folder.compensation).is_equivalent_to(job.compensation)


def _with_limit_note(model: LoadableModel, load: CoefficientCommand | None) -> LoadableModel:
    """The model, with a note if its temperature limits are not loaded into the INS."""
    note = load.extrapolation(model.compensation) if load else ""
    return replace(model, notes=(*model.notes, note), is_limited=False) if note else model


def _new_attitudes(fitted: Sequence[DwellRow], measured: Sequence[DwellRow]) -> int:
    """Number of measured dwells that began in an attitude in which no fitted dwell began."""
    rows = [*fitted, *measured]
    headings = heading_numbers([row.azimuth_deg for row in rows])
    attitudes = [(row.position, heading) for row, heading in zip(rows, headings, strict=True)]
    return sum(each not in attitudes[: len(fitted)] for each in attitudes[len(fitted) :])
