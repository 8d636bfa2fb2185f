"""The preflight check of a bench: opens it, checks each part, and closes it."""

from __future__ import annotations

import contextlib
import math
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from gyrobench.bench.dwells.setup_check import measured_scales
from gyrobench.bench.engine.preflight.ins import CanTraffic, ins_checks
from gyrobench.bench.engine.preflight.instruments import ANSWERS, chamber_checks, table_checks
from gyrobench.bench.engine.run_outcome import RunOutcome
from gyrobench.bench.foundations.clock import Clock, WallClock
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.operator_name import operator_name
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.foundations.text import counted, flag_text, hours_minutes, listed, plain_name
from gyrobench.bench.messages.delivery import read_secret
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.telemetry import TELEMETRY_COLUMNS
from gyrobench.bench.station.bench_lock import BenchLock
from gyrobench.bench.station.check_result import Check, CheckVerdict
from gyrobench.bench.station.instruments import Emulation, Outputs, open_ins
from gyrobench.bench.station.receivers import Receiver
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.can_ins import CanIns

#: The procedure of :func:`signal_map_checks`.
SIGNAL_MAP_CHECK = "signal_map_check"
#: Deviation of a velocity's scale from 1, in standard uncertainties, that is doubtful, and that is wrong.
_DOUBTFUL_SIGMAS, _MAX_SCALE_SIGMAS = 3.0, 4.0
#: Size of a frame in the raw log, compressed, and of a value in the telemetry.
_BYTES_PER_FRAME, _BYTES_PER_VALUE = 12.0, 8.0
#: Size of reports, figures, copies of the inputs, and journal.
_FIXED_BYTES = 50e6
#: Factor for repeated dwells, holds, and other data on the disk.
_MARGIN = 2.0
_GB = 1e9


def check_bench(
    station: str,
    procedure: str | None,
    emulation: Emulation,
    folder: Path,
    clock: Clock | None = None,
    acknowledged: Sequence[str] = (),
) -> list[Check]:
    """Check whether a bench is ready for a procedure, or in general if none is given. Moves nothing.

    An INS that is off and that the bench can switch on is on during the check. ``station`` and ``procedure``
    are files or names of shipped ones, ``folder`` the parent of the run folder, and ``clock`` by default that
    of the station; ``acknowledged`` instruments may be past due. Raises DocumentError if the station file is
    wrong, and BenchInUseError if a run holds the bench.
    """
    bench = Station(find_document("stations", station))
    bench.check_dbc()
    clock = clock or bench.new_clock()
    plan, procedure_check = _plan_check(bench, procedure)
    with (
        BenchLock(bench, folder, clock),
        contextlib.ExitStack() as resources,
        Outputs(bench, clock, emulation) as outputs,
    ):

        def open_driver(unit: Station) -> CanIns:
            driver = open_ins(unit, clock, emulation, bench)
            resources.callback(driver.close)
            return driver

        traffic = {unit: CanTraffic() for unit in bench.units}
        return [
            *_station_checks(bench),
            procedure_check,
            *calibration_checks(bench, acknowledged),
            *table_checks(bench, lambda: outputs.table),
            *chamber_checks(bench, lambda: outputs.chamber),
            *(
                replace(check, subject=unit.instrument)
                for unit in bench.units
                for check in ins_checks(unit, outputs, partial(open_driver, unit), clock, traffic[unit])
            ),
            disk_check(bench, folder, plan, sum(each.frames_per_s for each in traffic.values())),
            *map(_message_check, bench.file.messages),
        ]


def _station_checks(station: Station) -> Iterator[Check]:
    """Failed checks if the station file has placeholders, or copies the gravity of an emulated one."""
    if missing := station.not_filled_in:
        found = f"not filled in yet: {listed(missing)}"
        yield Check.of("station", "file filled in", False, found, f"Fill in {station.path}.")
    if caution := station.gravity_caution:
        yield Check.of("station", "gravity", False, caution, f"Correct {station.path}.")


def calibration_checks(station: Station, acknowledged: Sequence[str]) -> Iterator[Check]:
    """Check that no calibration listed in the station file is past due."""
    today = WallClock().utc().date()
    past_due = station.file.traceability.past_due(today)
    for name, instrument in station.file.traceability.instruments():
        found = past_due.get(name, f"certificate {instrument.certificate}, due {instrument.due}")
        is_good = name not in past_due or name in acknowledged
        if name in past_due and is_good:
            found += f"; acknowledged by {operator_name()}"
        advice = f"Have it calibrated, or acknowledge it with --acknowledge {name}."
        yield Check.of(plain_name(name), "calibration", is_good, found, advice)


def signal_map_checks(outcome: RunOutcome, folder: RunFolder) -> Iterator[Check]:
    """Checks of each unit's signs, axes and mounting, from its dwell in a run of :data:`SIGNAL_MAP_CHECK`."""
    for number, unit in outcome.units.items() or [("", outcome)]:
        subject, what, advice = f"INS {number}".strip(), "signs and axes", ""
        dwell = next(iter(unit.dwells), None)
        is_good = dwell is not None and dwell.estimate is not None
        if dwell is not None and is_good:
            found = "velocities and attitude agree with the tilt of the INS and the path of the table"
            scales = measured_scales([dwell.evidence]) if dwell.evidence else []
            sigmas = max((abs(scale - 1.0) / sigma for scale, sigma in scales), default=0.0)
            if sigmas > _DOUBTFUL_SIGMAS or not dwell.are_signs_tested:
                is_good = dwell.are_signs_tested or sigmas <= _MAX_SCALE_SIGMAS
                found = "a velocity has a doubtful scale" if sigmas > _DOUBTFUL_SIGMAS else "not tested"
                found = found if is_good else "the velocities do not follow from the tilt of the INS"
                advice = "Check signals, signs and scale of velocities and attitude, and their resolution."
            if scales:
                both, east, north = (f"{scale:.2f} ± {sigma:.2f}" for scale, sigma in scales)
                found += f"; scale of the velocities {both}, of one alone: East {east}, North {north}"
        else:
            found = (flag_text(dwell.flags) if dwell else "") or unit.reason or outcome.reason
        found = f"{found.rstrip('.')}. Run folder: {folder.path}"
        if is_good and advice:
            yield Check.skipped(subject, what, found, advice)
        else:
            yield Check.of(subject, what, is_good, found, advice)


def no_instrument_answers(checks: Iterable[Check]) -> bool:
    """Whether none of the instruments answered."""
    return all(check.verdict is not CheckVerdict.PASS for check in checks if check.what == ANSWERS)


def _plan_check(station: Station, procedure: str | None) -> tuple[Plan | None, Check]:
    subject, what = "procedure", "within limits"
    if procedure is None:
        return None, Check.skipped(subject, what, "no procedure given", "Add --procedure to check one.")
    try:
        document, model = load_procedure(find_document("procedures", procedure))
        plan = station.plan(document, model)
    except DocumentError as error:
        return None, Check.of(subject, what, False, str(error), "Correct the procedure.")
    found = f"{counted(plan.dwell_count, 'dwell')} in {hours_minutes(plan.duration_s)} h"
    return plan, Check.of(subject, what, True, found, "")


def disk_check(station: Station, folder: Path, plan: Plan | None, frames_per_s: float) -> Check:
    """Check whether a whole run fits on the disk, with a margin; ``frames_per_s`` may be NaN."""
    subject, what = "disk", "free space"
    if math.isnan(frames_per_s):
        return Check.skipped(subject, what, "the data rate is unknown: nothing was received from the CAN bus")
    telemetry_per_s = len(TELEMETRY_COLUMNS) * _BYTES_PER_VALUE / station.file.instruments_period_s
    per_h = 3600.0 * (frames_per_s * _BYTES_PER_FRAME + telemetry_per_s)
    existing = next(each for each in (folder.absolute(), *folder.absolute().parents) if each.exists())
    if not os.access(existing, os.W_OK):
        advice = "Choose another folder with --out."
        return Check.of(subject, what, False, f"{existing} can't be written by this user", advice)
    free = shutil.disk_usage(existing).free
    found = f"{free / _GB:.1f} GB free at {existing}, a run writes {per_h / 1e6:.1f} MB/h"
    if plan is None:
        return Check.skipped(subject, what, found, "Give a valid --procedure to check its whole duration.")
    needed = _FIXED_BYTES + _MARGIN * per_h * plan.duration_s / 3600.0
    return Check.of(
        subject,
        what,
        free >= needed,
        f"{found}, {hours_minutes(plan.duration_s)} h need {needed / _GB:.2f} GB with margin",
        "Free some space, or choose a run folder on another disk.",
    )


def _message_check(receiver: Receiver) -> Check:
    """Check that the secret of a receiver can be read; nothing is sent."""
    try:
        read_secret(receiver)
    except DocumentError as error:
        return Check.of(
            "messages", receiver.kind, False, str(error), "Add the secret, or remove the receiver."
        )
    events = listed([plain_name(event) for event in receiver.on])
    return Check.of("messages", receiver.kind, True, f"{receiver.address} receives: {events}", "")
