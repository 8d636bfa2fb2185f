"""Preflight check of the INS and its CAN bus, from ten seconds of its output."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial

import numpy as np

from gyrobench.bench.bias.dwell import MAX_ATTITUDE_DISAGREEMENT
from gyrobench.bench.dwells.setup_check import latitude_fault
from gyrobench.bench.engine.preflight.instruments import failed_request_check, identity_check, no_answer_check
from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import InstrumentError, NoReplyError
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.navigation.attitude import angle_between
from gyrobench.bench.station.check_result import Check
from gyrobench.bench.station.instruments import CHECK_SUPPLY, Outputs
from gyrobench.bench.station.station import Station
from gyrobench.drivers.frames import ERROR_FRAME, FrameBlock, concatenate
from gyrobench.drivers.ins.can_ins import CanIns
from gyrobench.drivers.ins.ins_status import InsStatus
from gyrobench.drivers.ins.navigation_data import NavigationData, decode_navigation
from gyrobench.drivers.ins.readout import Alignment, InsMode
from gyrobench.drivers.ins.resolution import LIMIT_DPH, resolution_report

_SUBJECT = "INS"
_check = partial(Check.of, _SUBJECT)
#: An INS that is on sends a frame within this time; it sends its status about once a second.
_FIRST_FRAME_S = 3.0
#: An INS that was switched on starts within this time.
_START_S = 180.0
_OBSERVE_S = 10.0
#: Relative tolerance of the rates of clocks and epochs over that time.
_RATE_TOLERANCE = 0.02
#: An INS whose clock is past this date sends the calendar time, in seconds since 1970.
_CALENDAR_S = datetime(2020, 1, 1, tzinfo=UTC).timestamp()
_OFFSET_LIMIT_S = 60.0
#: Share of epochs that may arrive late.
_MAX_LATE_SHARE = 0.05
#: Epochs that the start and the end of the observation may cut off.
_CUT_OFF_EPOCHS = 2


@dataclass
class CanTraffic:
    """Frames received from the bus during the check."""

    duration_s: float = 0.0  #: On the run's clock.
    blocks: list[FrameBlock] = field(default_factory=list)  #: As polled.
    polled_s: list[float] = field(default_factory=list)  #: When each block was polled, on the run's clock.

    @property
    def frames_per_s(self) -> float:
        """Frames per second; NaN before the observation."""
        return sum(map(len, self.blocks)) / self.duration_s if self.duration_s else math.nan


def ins_checks(
    station: Station, outputs: Outputs, ins: Callable[[], CanIns], clock: Clock, traffic: CanTraffic
) -> list[Check]:
    """Check the output of the INS; if the bench can switch it on, it is on during the check.

    ``outputs`` switch its supply. ``ins`` returns the driver, or raises if it can't be opened. ``traffic``
    is filled with the frames received from the bus.
    """
    try:
        driver = ins()
    except InstrumentError as error:
        return [no_answer_check(_SUBJECT, error)]
    checks: list[Check] = []
    try:
        with ExitStack() as resources:
            checks.extend(_powered_checks(station, outputs, driver, clock, traffic, resources))
    except InstrumentError as error:
        checks.append(failed_request_check(_SUBJECT, "switched off", error))
    return checks


def _powered_checks(
    station: Station, outputs: Outputs, ins: CanIns, clock: Clock, traffic: CanTraffic, resources: ExitStack
) -> Iterator[Check]:
    try:
        if not ins.sends_frames(_FIRST_FRAME_S):
            _switch_on(station, outputs, resources)
            _wait_for_start(station, ins, clock)
        else:
            yield from _supply_checks(station, outputs)
        yield identity_check(_SUBJECT, ins.identify(), station.file.ins.identity)
    except InstrumentError as error:
        yield _silent_check(station, error)
        return
    try:
        _observe(ins, clock, station.file.poll_period_s, traffic)
    except InstrumentError as error:
        yield failed_request_check(_SUBJECT, "frames", error)
        return
    yield from _state_checks(station, ins.status())
    yield _resolution_check(station, ins)
    yield from _stream_checks(station, outputs, ins, clock, traffic)


def _silent_check(station: Station, error: InstrumentError) -> Check:
    if station.file.unit.power == "operator" and isinstance(error, NoReplyError):
        found = "sends nothing; the operator switches it on"
        return Check.skipped(_SUBJECT, "answers", found, "Switch it on to check it.")
    if not error.instrument.startswith(_SUBJECT):  # it switches the supply
        found = f"not switched on: the {error.instrument}, whose output feeds it, failed: {error.message}"
        return Check.of(_SUBJECT, "answers", False, found, "Nothing else is checked until it answers.")
    return no_answer_check(_SUBJECT, error)


def _switch_on(station: Station, outputs: Outputs, resources: ExitStack) -> None:
    """Switch the supply on if it is off and the bench can; ``resources`` switches it off again."""
    unit = station.file.unit
    if unit.power == "chamber_event" and not outputs.chamber.is_event_on(unit.power_event):
        resources.callback(outputs.chamber.switch_event, unit.power_event, False)
        outputs.chamber.switch_event(unit.power_event, True)


def _supply_checks(station: Station, outputs: Outputs) -> Iterator[Check]:
    """Fail if the INS sends although its supply is off."""
    unit = station.file.unit
    with suppress(InstrumentError):  # the checks of the chamber report it
        if unit.power == "chamber_event" and not outputs.chamber.is_event_on(unit.power_event):
            found = f"sends although its output {unit.power_event} of the chamber is off"
            yield _check("supply", False, found, f"{CHECK_SUPPLY}.")


def _wait_for_start(station: Station, ins: CanIns, clock: Clock) -> None:
    deadline = Deadline(clock, _START_S if station.file.unit.power == "chamber_event" else 0.0)
    while not ins.sends_frames(_FIRST_FRAME_S):
        if deadline.expired():
            other_frames = f", but {frames}" if (frames := ins.describe_foreign_frames()) else ""
            subject = "the bus, its bit rate and the cable"
            if ins.has_foreign_frames:
                subject = "the DBC file and ins.identifier_offset"
            raise NoReplyError(_SUBJECT, f"sends nothing{other_frames}. Check its power, {subject}.")
    while ins.status().mode is InsMode.BOOT and not deadline.expired():
        clock.sleep(1.0)
        ins.poll()


def _observe(ins: CanIns, clock: Clock, period_s: float, traffic: CanTraffic) -> None:
    ins.poll()
    begin_s = clock.now()
    deadline = Deadline(clock, _OBSERVE_S)
    while not deadline.expired():
        clock.sleep(min(period_s, deadline.remaining_s()))
        traffic.blocks.append(ins.poll())
        traffic.polled_s.append(clock.now())
    traffic.duration_s = clock.now() - begin_s


def _resolution_check(station: Station, ins: CanIns) -> Check:
    limits = resolution_report(station.file.ins.signals, ins.codec)
    worst = max(limits, key=lambda limit: limit.worst_dph)
    steps = {limit.unit: limit.lsb for limit in limits}
    return _check(
        "resolution",
        all(limit.sufficient for limit in limits),
        f"steps of {' and '.join(f'{lsb:.2g} {unit}' for unit, lsb in steps.items())} move a bias by up to "
        f"{worst.worst_dph:.2g} deg/h in windows of 10 min; the limit is {LIMIT_DPH:g} deg/h",
        f"Map a finer output than {worst.signal}, or increase the duration of the windows.",
    )


def _state_checks(station: Station, status: InsStatus) -> Iterator[Check]:
    signals = station.file.ins.signals
    if signals.mode is not None:
        alignment = {
            Alignment.UNKNOWN: "", Alignment.NONE: ", not aligned",
            Alignment.COARSE: ", coarsely aligned", Alignment.FINE: ", aligned",
        }[status.alignment]  # fmt: skip
        yield _check(
            "mode",
            status.mode not in (InsMode.BOOT, InsMode.FAULT, InsMode.UNKNOWN),
            f"reports {status.mode_text}{alignment}",
            "Read its built-in test results, and check `mode` in the signal map.",
        )
    if signals.latitude is not None:
        yield _check(
            "latitude",
            abs(status.latitude) < math.pi and not latitude_fault(status.latitude, station.site),
            f"is {math.degrees(status.latitude):.4f} deg, the station's "
            f"{math.degrees(station.site.latitude):.4f} deg",
            "Correct location.latitude_deg in the station file, the latitude entered in the INS, or "
            "`latitude` in the signal map.",
        )
    else:
        advice = "Map it if the INS sends it; else compare the one entered in it with location.latitude_deg."
        yield Check.skipped(_SUBJECT, "latitude", "the signal map has none", advice)
    yield _temperature_check(station, status)


def _temperature_check(station: Station, status: InsStatus) -> Check:
    values = [
        (each.what, each.read(status), each.level)
        for each in station.file.interlocks.ins_temperatures(station.file.ins.signals)
    ]
    if not values:
        return Check.skipped(
            _SUBJECT, "temperatures", "the signal map has none", "Map them if the INS sends them."
        )
    outside = [
        f"{name} {'unknown' if math.isnan(c) else f'{c:.1f} degC'}"
        for name, c, level in values
        if not level.low_c <= c <= level.high_c
    ]
    valid = [c for _, c, _ in values if math.isfinite(c)]
    span = f"{min(valid):.1f} to {max(valid):.1f} degC" if valid else "none known"
    return _check(
        "temperatures",
        not outside,
        f"{counted(len(values), 'signal')}, {span}"
        + (f"; outside the interlock limits: {', '.join(outside)}" if outside else ""),
        "Check the sensors and the signal map.",
    )


def _stream_checks(
    station: Station, outputs: Outputs, ins: CanIns, clock: Clock, traffic: CanTraffic
) -> Iterator[Check]:
    received = concatenate(traffic.blocks)
    block = received.data_frames()
    errors = int(np.count_nonzero(received.flags & ERROR_FRAME))
    data = decode_navigation(block, station.file.ins.signals, ins.codec)
    counts = data.counts
    problems = {
        "lost": counts.lost, "repeated": counts.repeated, "late": counts.late, "restarts": counts.restarts,
        "contradicted": counts.contradicted, "short frames": data.short_frames, "error frames": errors,
        "missing": _missing_epochs(station, traffic, len(data.ins_time_s) + counts.lost),
        "surplus frames": _surplus_frames(station, ins, block, len(data.ins_time_s) + counts.lost),
    }  # fmt: skip
    found = ", ".join(f"{count} {name}" for name, count in problems.items() if count)
    # The load of this computer occasionally delays an epoch; no result depends on that.
    is_late = counts.late > _MAX_LATE_SHARE * len(data.ins_time_s)
    faults = [name for name, count in problems.items() if count and (name != "late" or is_late)]
    yield _check(
        "frames without gaps",
        len(data.ins_time_s) > 1 and not faults,
        f"{len(data.ins_time_s)} epochs in {traffic.duration_s:.0f} s, {found or 'none lost'}; "
        f"{traffic.frames_per_s:.0f} frames per second",
        "Check bit rate, termination and bus load, the signal map's epoch_messages, and for a second node.",
    )
    if len(data.ins_time_s) < 3:
        return
    yield _epoch_rate_check(station, data)
    yield from _attitude_checks(station, outputs, data)
    yield from _clock_checks(station, clock, data, traffic)


def _attitude_checks(station: Station, outputs: Outputs, data: NavigationData) -> Iterator[Check]:
    """Compare the attitude of an INS that navigates with that of the table.

    At rest, a wrong sign has a visible effect only over minutes: the dwells of a run test for that.
    """
    if data.mode[-1] != InsMode.NAVIGATE or not np.isfinite(data.attitude[-1]).all():
        return
    try:
        angles = station.table_axes_of(outputs.table.read().position_deg)
    except InstrumentError:  # the checks of the table report it
        return
    error = angle_between(data.attitude[-1], station.table.attitude(*angles))
    yield _check(
        "attitude",
        error <= MAX_ATTITUDE_DISAGREEMENT,
        f"{math.degrees(error):.1f} deg from that of the table; "
        f"at most {math.degrees(MAX_ATTITUDE_DISAGREEMENT):g} deg",
        "Check signs and axes of `attitude` in the signal map, and `mounting` and axes of the table.",
    )


def _missing_epochs(station: Station, traffic: CanTraffic, epochs: int) -> int:
    """Number of epochs missing without a visible gap; one at each end may be cut off."""
    expected = int(traffic.duration_s / station.file.ins.signals.epoch_period_s * (1.0 - _RATE_TOLERANCE))
    return max(0, expected - _CUT_OFF_EPOCHS - epochs)


def _surplus_frames(station: Station, ins: CanIns, block: FrameBlock, epochs: int) -> int:
    """Number of frames beyond one per message and epoch: repeated, or sent by a second node."""
    names = station.file.ins.signals.epoch_messages or []
    frames = max((len(block.with_id(ins.codec.arbitration_id(name))) for name in names), default=0)
    return max(0, frames - _CUT_OFF_EPOCHS - epochs)


def _epoch_rate_check(station: Station, data: NavigationData) -> Check:
    period_s = station.file.ins.signals.epoch_period_s
    median_s = float(np.median(np.diff(data.timestamp_s)))
    # The time stamp of one epoch jitters by some milliseconds; the mean over many is more accurate.
    mean_s = float(data.timestamp_s[-1] - data.timestamp_s[0]) / (len(data.timestamp_s) - 1)
    return _check(
        "epoch rate",
        abs(mean_s / period_s - 1.0) <= _RATE_TOLERANCE or abs(median_s / period_s - 1.0) <= _RATE_TOLERANCE,
        f"one epoch in {mean_s * 1e3:.1f} ms, {period_s * 1e3:g} ms in the signal map",
        "Correct epoch_period_s of the signal map, or the INS's output rate.",
    )


def _clock_checks(
    station: Station, clock: Clock, data: NavigationData, traffic: CanTraffic
) -> Iterator[Check]:
    stamps_s = concatenate(traffic.blocks).timestamp_s
    rate = _slope(np.repeat(traffic.polled_s, [len(block) for block in traffic.blocks]), stamps_s)
    back = int(np.sum(np.diff(stamps_s) < 0.0))
    yield _check(
        "CAN time stamps",
        back == 0 and abs(rate - 1.0) <= _RATE_TOLERANCE,
        f"run at {rate:.4f} of the run's clock" + (f", jump back {back} times" if back else ""),
        "Check the adapter's time stamps (driver, Z option) and the load of this computer.",
    )
    if station.file.ins.signals.time_s is None:
        yield Check.skipped(_SUBJECT, "clock", "the signal map has no time of the INS")
        return
    rate = _slope(data.timestamp_s, data.ins_time_s)
    ins_s = float(data.ins_time_s[-1])
    is_calendar = ins_s > _CALENDAR_S and clock.speed == 1.0  # fast clocks start at different times
    offset_s = ins_s - clock.utc().timestamp() if is_calendar else 0.0
    yield _check(
        "clock",
        abs(rate - 1.0) <= _RATE_TOLERANCE and abs(offset_s) <= _OFFSET_LIMIT_S,
        f"runs at {rate:.4f} of the CAN time stamps; "
        + (f"{offset_s:+.1f} s from this computer's" if is_calendar else "no calendar time"),
        "Synchronize this computer's clock (NTP) and the INS; check time_s of the signal map.",
    )


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    return float(np.polyfit(x - x[0], y - y[0], 1)[0])
