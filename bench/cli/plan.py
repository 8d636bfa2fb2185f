"""`gyrobench plan`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrobench.bench.cli.options import EMULATED, PROCEDURE_HELP, StationOption, complete_plan
from gyrobench.bench.cli.output import JsonOption, console, print_result
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError, RunFolderError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gyrobench.bench.closure.outcome import Closure
    from gyrobench.bench.closure.planned_campaign import UnitProperties
    from gyrobench.bench.engine.job import Job
    from gyrobench.bench.station.station import Station

_DEFAULT_TARGET_DPH = 0.002
_NO_CYCLE = (
    "No cycle is numbered: a search (gyrobench close) can hold none out. Name the variable of the loop over\n"
    "the repeated profile 'cycle'."
)


def plan(
    procedure: Annotated[
        str,
        typer.Argument(
            help=f"{PROCEDURE_HELP} With --observability: a list of rotations.", autocompletion=complete_plan
        ),
    ],
    station: StationOption = EMULATED,
    figure: Annotated[
        Path | None, typer.Option(help="PNG file to write; default: plan_PROCEDURE.png.")
    ] = None,
    separability: Annotated[
        bool, typer.Option(help="Show which effects on the bias its dwells distinguish.")
    ] = False,
    target_dph: Annotated[
        float | None,
        typer.Option(
            min=1e-6,
            help="With --separability: size of effect that matters, deg/h rms; default: "
            f"{_DEFAULT_TARGET_DPH:g}.",
        ),
    ] = None,
    closure: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="With --separability: folder of a search (gyrobench close) or its run. Noise, temperatures, "
            "effects and ties are those of the unit searched.",
        ),
    ] = None,
    observability: Annotated[
        bool, typer.Option(help="Show the expected uncertainty of each coefficient for a list of rotations.")
    ] = False,
    whole_turns_arcsec: Annotated[
        float | None,
        typer.Option(min=1e-3, help="With --observability: sigma of the table's return after whole turns."),
    ] = None,
    reach: Annotated[
        str,
        typer.Option(
            metavar="NAME=NUMBER,...",
            help="With --observability: propose the shortest list that reaches these uncertainties, as "
            "gyro_scale_factor_z_ppm=0.5, with commas between several; start, dwell and rate are the list's.",
        ),
    ] = "",
    as_json: JsonOption = False,
) -> None:
    """Show the steps and duration of a procedure. Uses no instrument.

    The temperature profile and the positions are drawn as a PNG file; with --separability also
    separability_PROCEDURE.png, the similarity of effects.

    With --json: {"procedure", "station", "duration_s", "dwells", "figure", "unsettled_soaks",
    "unreachable_limits", "steps": [{"number", "step", "what", "start_s", "duration_s", "dwell", "cycle"}]},
    times from the start of the plan, "figure" null where it could not be written.

    With --observability, for a list of rotations: the expected uncertainty of each coefficient of the
    sensors' error model, with those of gravity and latitude of the station; with --json {"rotation_list",
    "station", "duration_s", "coefficients"}. With --reach for the proposed list, written to
    LIST_shortest.yaml ("file").

    Example: gyrobench plan six_position_fig7 --figure plan.png
    """
    from gyrobench.bench.engine.job import prepare_job

    for option, value, main_option, is_given in (
        ("--target-dph", target_dph, "--separability", separability),
        ("--closure", closure, "--separability", separability),
        ("--reach", reach or None, "--observability", observability),
        ("--whole-turns-arcsec", whole_turns_arcsec, "--observability", observability),
    ):
        if value is not None and not is_given:
            raise DocumentError(f"{option} has a meaning with {main_option} only. Add {main_option}")
    if observability:
        _show_observability(procedure, station, whole_turns_arcsec, reach, as_json)
        return
    if as_json and separability:
        raise DocumentError("--separability prints text only: it can't be combined with --json")
    job = prepare_job(procedure, station)
    searched = _read_search(closure) if closure else None
    _show_steps(job, figure, as_json)
    if separability:
        _print_separability(job, target_dph or _DEFAULT_TARGET_DPH, searched)


def _show_steps(job: Job, figure: Path | None, as_json: bool) -> None:
    from gyrobench.bench.closure.planned_campaign import unreachable_limits
    from gyrobench.bench.procedure.timeline import is_cycle_unnumbered, timeline_rows, unsettled_soaks
    from gyrobench.bench.report.figures.temperatures import plan_figure
    from gyrobench.bench.report.terminal.tables import timeline_table

    plan, soaks = job.plan, unsettled_soaks(job.plan)
    is_noise_known = job.station.file.ins.noise != "estimated"
    limits = unreachable_limits(plan, declared_properties(job.station)) if is_noise_known else []
    path = figure or Path(f"plan_{plan.procedure.procedure}.png")
    problem = _problem_of_saving(plan_figure(plan), path)
    record = {
        "procedure": plan.procedure.procedure,
        "station": job.station.file.station,
        "duration_s": plan.duration_s,
        "dwells": plan.dwell_count,
        "figure": None if problem else path,
        "unsettled_soaks": soaks,
        "unreachable_limits": limits,
        "steps": [
            {
                "number": planned.number,
                "step": planned.step.name,
                "what": planned.step.describe(),
                "start_s": planned.start_s,
                "duration_s": planned.duration_s,
                "dwell": planned.dwell or None,
                "cycle": planned.cycle,
            }
            for planned in plan.steps
        ],
    }
    heading = ["Soaks that will probably end by at_most_s before the gyros have settled:"] if soaks else []
    lines = [*heading, *(f"  {each}" for each in soaks)]
    if limits:
        lines.append("Acceptance limits that no unit can pass because of the noise of these dwells:")
    lines += [f"  {each}" for each in limits]
    if is_cycle_unnumbered(plan):
        lines.append(_NO_CYCLE)
    if figure is None or problem is None:
        lines.append(f"No figure: {problem}" if problem else f"Figure   {path}")
    print_result(record, as_json, timeline_table(timeline_rows(plan), plan.duration_s), *lines)
    if problem and figure:
        raise problem


def _problem_of_saving(figure: Figure, path: Path) -> RunFolderError | None:
    """Save a figure; returns the error if that fails, so that the results are printed."""
    from gyrobench.bench.report.figures.style import save_figure

    try:
        save_figure(figure, path)
    except RunFolderError as error:
        return error
    return None


def _show_observability(
    name: str, station_name: str, whole_turns_arcsec: float | None, reach: str, as_json: bool
) -> None:
    from math import pi

    from gyrobench.bench.calibration.list_search import parse_targets, shortest_list
    from gyrobench.bench.calibration.results import expected_rows
    from gyrobench.bench.calibration.rotation_list import (
        RotationSetup,
        expected_noise,
        expected_uncertainties,
        load_rotation_list,
        rotation_list_text,
    )
    from gyrobench.bench.dwells.measurement_setup import measurement_setup
    from gyrobench.bench.foundations.csv_tables import write_text
    from gyrobench.bench.foundations.shipped import find_document
    from gyrobench.bench.report.terminal.calibration import expected_summary
    from gyrobench.bench.station.station import Station

    rotations = load_rotation_list(find_document("rotations", name))
    station = Station(find_document("stations", station_name))
    has_increments = station.file.ins.signals.increments is not None
    step_mps = 0.0 if has_increments else measurement_setup(station).velocity_lsb_mps
    noise = expected_noise(station.noise(0.0, 0.0), rotations, step_mps)
    whole_turns = None if whole_turns_arcsec is None else whole_turns_arcsec * pi / 648000.0
    max_rate_dps = station.file.rate_table.limits.rate_dps
    site_sigmas = station.gravity_and_sigma[1], station.prior().latitude
    setup = RotationSetup(
        station.table, station.site, noise, max_rate_dps, whole_turns, site_sigmas, has_increments
    )
    files = []
    if reach:
        rotations, uncertainties = shortest_list(rotations, parse_targets(reach), setup)
        files = [Path(f"{rotations.rotation_list}.yaml")]
        write_text(files[0], rotation_list_text(rotations))
    else:
        uncertainties = expected_uncertainties(rotations, setup)
    record = {
        "rotation_list": rotations.rotation_list,
        "station": station.file.station,
        "duration_s": uncertainties.duration_s,
        "coefficients": expected_rows(uncertainties),
        "file": files[0] if files else None,
    }
    summary = expected_summary(rotations, uncertainties, noise, site_sigmas)
    print_result(record, as_json, summary, *(f"Written  {path}" for path in files))


def _read_search(folder: Path) -> Closure:
    from gyrobench.bench.closure.loop import repeat_search

    try:
        return repeat_search(folder)
    except (MeasurementError, RunFolderError) as error:
        raise DocumentError(str(error)) from error


def _print_separability(job: Job, target_dph: float, closure: Closure | None) -> None:
    from gyrobench.bench.closure.effects import all_effects
    from gyrobench.bench.closure.planned_campaign import planned_campaign
    from gyrobench.bench.closure.procedure_changes import ChangeablePlan, advise, advise_ties
    from gyrobench.bench.closure.separability import searched_dwells, separability
    from gyrobench.bench.closure.tie_forecast import measured_properties, tie_forecasts
    from gyrobench.bench.report.figures.closure import separability_figure
    from gyrobench.bench.report.terminal.separability import closure_forecast, separability_summary

    unit, name = declared_properties(job.station), job.plan.procedure.procedure
    if closure:
        unit = measured_properties(closure, job.plan.steps[0].before.thermal)
    try:
        campaign = planned_campaign(job.plan, unit)
    except MeasurementError as error:
        typer.echo(str(error))
        return
    effects = [each.effect for each in closure.evidence] if closure else all_effects(job.document.path)
    result = separability(searched_dwells(campaign), effects, closure.effects if closure else ())
    unchanged = ChangeablePlan(job.document, job.plan, job.station.plan_document, unit)
    advice = [] if closure else advise(unchanged, result, target_dph)
    console().print(separability_summary(result, len(campaign), unit, target_dph, advice))
    if closure:
        ties = tie_forecasts(closure, campaign)
        advice = advise_ties(unchanged, closure, ties)
        console().print(closure_forecast(closure, unit, result.expected_dph, ties, advice))
    path = Path(f"separability_{name}.png")
    problem = _problem_of_saving(separability_figure(result, target_dph, name), path)
    typer.echo(f"No figure: {problem}" if problem else f"Figure   {path}")


def declared_properties(station: Station) -> UnitProperties:
    """Properties of the unit on a station: its sensors, and its noise if it is declared."""
    from gyrobench.bench.closure.planned_campaign import UnitProperties

    signals, noise = station.file.ins.signals, station.file.ins.noise
    unit = UnitProperties(
        has_boards=signals.gyro_electronics_temperature is not None,
        has_case=signals.case_temperature is not None,
    )
    if noise == "estimated":
        return unit
    walk = noise.angle_random_walk_deg_per_sqrt_h
    return replace(unit, angle_random_walk_deg_per_sqrt_h=walk, noise_source="declared by the station")
