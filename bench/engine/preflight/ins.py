"""Preflight of the INS and its bus: a few seconds of what it sends."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime

import can
import numpy as np

from gyrobench.bench.engine.preflight.answer import answered, failed, unanswered
from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import InstrumentError, NoReplyError
from gyrobench.bench.station.check import Check
from gyrobench.bench.station.instruments import Outputs
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.can_bus import FrameBlock
from gyrobench.drivers.ins.can_ins import CanIns
from gyrobench.drivers.ins.ins_status import InsStatus
from gyrobench.drivers.ins.navigation_data import NavigationData, decode_navigation
from gyrobench.drivers.ins.readout import Alignment, InsMode
from gyrobench.drivers.ins.resolution import resolution_report

_SUBJECT = "INS"
#: A unit that is on is heard within this; its status comes once a second or so.
_LISTEN_S = 3.0
#: A unit that was switched on has started within this.
_START_S = 180.0
_OBSERVE_S = 10.0
#: Rates of clocks and epochs are told no better than this in that time.
_RATE_TOLERANCE = 0.02
#: An INS whose clock is beyond this date tells the calendar time, in seconds since 1970.
_CALENDAR_S = datetime(2020, 1, 1, tzinfo=UTC).timestamp()
_OFFSET_LIMIT_S = 60.0
#: Epochs that the beginning and the end of the listening may cut off.
_AT_THE_ENDS = 2


@dataclass
class Listened:
    """What came from the bus in some seconds.

    Attributes
    ----------
    duration_s : float
        On the run's clock.
    arrived_s : list of float
        When each batch of frames was taken from the bus, on the run's clock.
    """

    duration_s: float = 0.0
    messages: list[can.Message] = field(default_factory=list)
    arrived_s: list[float] = field(default_factory=list)

    @property
    def frames_per_s(self) -> float:
        """How many frames there are to be recorded in a second."""
        return len(self.messages) / self.duration_s if self.duration_s else math.nan


def ins_checks(
    station: Station, outputs: Outputs, ins: Callable[[], CanIns], clock: Clock, listened: Listened
) -> list[Check]:
    """Look whether it sends what it should; one that the bench can switch on is on meanwhile.

    Parameters
    ----------
    outputs
        Switch the unit's supply.
    ins : callable
        Gives the driver, or raises where it can't be opened.
    listened : Listened
        Is filled with what came from the bus.
    """
    try:
        opened = ins()
    except InstrumentError as error:
        return [unanswered(_SUBJECT, error)]
    checks: list[Check] = []
    try:
        with contextlib.ExitStack() as switched:
            checks.extend(_running(station, outputs, opened, clock, listened, switched))
    except InstrumentError as error:
        checks.append(failed(_SUBJECT, "switched off again", error))
    return checks


def _running(
    station: Station,
    outputs: Outputs,
    ins: CanIns,
    clock: Clock,
    listened: Listened,
    switched: contextlib.ExitStack,
) -> Iterator[Check]:
    try:
        if not _is_heard(ins, clock, _LISTEN_S):
            _switch_on(station, outputs, switched)
            _await_start(station, ins, clock)
        yield answered(_SUBJECT, ins.identify(), station.file.ins.identity)
    except InstrumentError as error:
        yield _silent(station, error)
        return
    try:
        _listen(ins, clock, station.poll_period_s, listened)
    except InstrumentError as error:
        yield failed(_SUBJECT, "listening", error)
        return
    yield from _states(station, ins.status())
    yield _resolution(station, ins)
    yield from _stream(station, ins, clock, listened)


def _silent(station: Station, error: InstrumentError) -> Check:
    if station.unit.power == "operator" and isinstance(error, NoReplyError):
        why = "sends nothing; it is the operator who switches it"
        return Check.skipped(_SUBJECT, "answers", why, "Switch it on to have it looked at.")
    return unanswered(_SUBJECT, error)


def _switch_on(station: Station, outputs: Outputs, switched: contextlib.ExitStack) -> None:
    """Switch the unit's supply on where the bench can and it is off; the stack switches it off."""
    unit = station.unit
    if unit.power == "chamber_event" and not outputs.chamber.is_event_on(unit.power_event):
        switched.callback(outputs.power_unit, False)
        outputs.power_unit(True)


def _is_heard(ins: CanIns, clock: Clock, limit_s: float) -> bool:
    deadline = Deadline(clock, limit_s)
    heard = ins.health().frames
    while ins.health().frames == heard and not deadline.expired():
        clock.sleep(0.1)
        ins.poll()
    return ins.health().frames > heard


def _await_start(station: Station, ins: CanIns, clock: Clock) -> None:
    limit_s = _START_S if station.unit.power == "chamber_event" else 0.0
    deadline = Deadline(clock, limit_s)
    while not _is_heard(ins, clock, _LISTEN_S):
        if deadline.expired():
            raise NoReplyError(
                _SUBJECT, "sends nothing. Check its power, the bus, its bit rate and the cable."
            )
    while ins.status().mode is InsMode.BOOT and not deadline.expired():
        clock.sleep(1.0)
        ins.poll()


def _listen(ins: CanIns, clock: Clock, period_s: float, listened: Listened) -> None:
    ins.poll()
    begin_s = clock.now()
    deadline = Deadline(clock, _OBSERVE_S)
    while not deadline.expired():
        clock.sleep(min(period_s, deadline.remaining_s()))
        messages = ins.poll()
        listened.messages += messages
        listened.arrived_s += [clock.now()] * len(messages)
    listened.duration_s = clock.now() - begin_s


def _resolution(station: Station, ins: CanIns) -> Check:
    limits = resolution_report(station.file.ins.signals, ins.codec)
    worst = max(limits, key=lambda limit: limit.worst_dph / limit.limit_dph)
    steps = {f"{limit.unit}": limit.lsb for limit in limits}
    return Check.of(
        _SUBJECT,
        "resolution",
        all(limit.sufficient for limit in limits),
        f"steps of {' and '.join(f'{lsb:.2g} {unit}' for unit, lsb in steps.items())} move a bias by up to "
        f"{worst.worst_dph:.2g} deg/h in windows of 10 min; the limit is {worst.limit_dph:g} deg/h",
        f"Map a finer output than {worst.signal}, or navigate longer.",
    )


def _states(station: Station, status: InsStatus) -> Iterator[Check]:
    signals = station.file.ins.signals
    if signals.mode is not None:
        alignment = {
            Alignment.UNKNOWN: "", Alignment.NONE: ", not aligned",
            Alignment.COARSE: ", coarsely aligned", Alignment.FINE: ", aligned",
        }[status.alignment]  # fmt: skip
        yield Check.of(
            _SUBJECT,
            "its state",
            status.mode not in (InsMode.FAULT, InsMode.UNKNOWN),
            f"reports {status.mode.name.lower()}{alignment}",
            "Read its own diagnostics, and check the signal map's mode.",
        )
    yield _temperatures(station, status)


def _temperatures(station: Station, status: InsStatus) -> Check:
    signals, rules = station.file.ins.signals, station.file.interlocks
    values = []
    if signals.case_temperature is not None:
        values.append(("case", status.case_c, rules.case_temperature))
    if signals.gyro_optics_temperature is not None:
        values += [
            (f"optics {a}", float(c), rules.gyro_temperature)
            for a, c in zip("xyz", status.optics_c, strict=True)
        ]
    if signals.gyro_electronics_temperature is not None:
        values += [
            (f"electronics {a}", float(c), rules.gyro_temperature)
            for a, c in zip("xyz", status.electronics_c, strict=True)
        ]
    if not values:
        return Check.skipped(
            _SUBJECT, "temperatures", "the signal map has none", "Map them if the INS sends them."
        )
    wrong = [
        f"{name} {'unknown' if math.isnan(c) else f'{c:.1f} degC'}"
        for name, c, rule in values
        if not rule.low_c <= c <= rule.high_c
    ]
    known = [c for _, c, _ in values if math.isfinite(c)]
    span = f"{min(known):.1f} to {max(known):.1f} degC" if known else "none known"
    return Check.of(
        _SUBJECT,
        "temperatures",
        not wrong,
        f"{len(values)} of them, {span}" + (f"; outside the interlocks: {', '.join(wrong)}" if wrong else ""),
        "Check the sensors and the signal map.",
    )


def _stream(station: Station, ins: CanIns, clock: Clock, listened: Listened) -> Iterator[Check]:
    block = FrameBlock.from_messages(listened.messages)
    errors = len(listened.messages) - len(block)
    data = decode_navigation(block, station.file.ins.signals, ins.codec)
    counts = data.counts
    wrong = {
        "lost": counts.lost, "repeated": counts.repeated, "late": counts.late, "restarts": counts.restarts,
        "contradicted": counts.contradicted, "short frames": data.short_frames, "error frames": errors,
        "missing": _missing(station, listened, len(data.ins_time_s) + counts.lost),
        "frames too many": _surplus(station, ins, block, len(data.ins_time_s) + counts.lost),
    }  # fmt: skip
    said = ", ".join(f"{count} {name}" for name, count in wrong.items() if count)
    yield Check.of(
        _SUBJECT,
        "frames without gaps",
        len(data.ins_time_s) > 1 and not said,
        f"{len(data.ins_time_s)} epochs in {listened.duration_s:.0f} s, {said or 'none lost'}; "
        f"{listened.frames_per_s:.0f} frames a second",
        "Check bit rate, termination and bus load, the signal map's epoch_messages, and for a second node.",
    )
    if len(data.ins_time_s) < 3:
        return
    yield _epoch_rate(station, data)
    yield from _clocks(station, clock, data, listened)


def _missing(station: Station, listened: Listened, epochs: int) -> int:
    """Epochs that should have come in that time and left no gap; one at each end may be cut off."""
    due = int(listened.duration_s / station.file.ins.signals.epoch_period_s * (1.0 - _RATE_TOLERANCE))
    return max(0, due - _AT_THE_ENDS - epochs)


def _surplus(station: Station, ins: CanIns, block: FrameBlock, epochs: int) -> int:
    """Frames of an epoch's messages beyond one of each: repeated, or sent by a second node."""
    names = station.file.ins.signals.epoch_messages or []
    most = max((len(block.with_id(ins.codec.arbitration_id(name))) for name in names), default=0)
    return max(0, most - _AT_THE_ENDS - epochs)


def _epoch_rate(station: Station, data: NavigationData) -> Check:
    period_s = station.file.ins.signals.epoch_period_s
    seen_s = float(np.median(np.diff(data.timestamp_s)))
    # The stamp of one epoch jitters by some milliseconds; many epochs together tell better.
    mean_s = float(data.timestamp_s[-1] - data.timestamp_s[0]) / (len(data.timestamp_s) - 1)
    return Check.of(
        _SUBJECT,
        "rate of epochs",
        abs(mean_s / period_s - 1.0) <= _RATE_TOLERANCE or abs(seen_s / period_s - 1.0) <= _RATE_TOLERANCE,
        f"one every {mean_s * 1e3:.1f} ms, {period_s * 1e3:g} ms in the signal map",
        "Correct epoch_period_s of the signal map, or the INS's output rate.",
    )


def _clocks(station: Station, clock: Clock, data: NavigationData, listened: Listened) -> Iterator[Check]:
    stamps_s = np.array([message.timestamp for message in listened.messages])
    rate = _slope(np.array(listened.arrived_s), stamps_s)
    back = int(np.sum(np.diff(stamps_s) < 0.0))
    yield Check.of(
        _SUBJECT,
        "CAN time stamps",
        back == 0 and abs(rate - 1.0) <= _RATE_TOLERANCE,
        f"run at {rate:.4f} of the run's clock" + (f", go back {back} times" if back else ""),
        "Check the adapter's time stamps (its driver, its Z option) and the load of this computer.",
    )
    if station.file.ins.signals.time_s is None:
        yield Check.skipped("INS", "its clock", "the signal map has no time of the INS")
        return
    rate = _slope(data.timestamp_s, data.ins_time_s)
    told_s = float(data.ins_time_s[-1])
    is_calendar = told_s > _CALENDAR_S and clock.speed == 1.0  # two fast clocks began at different times
    offset_s = told_s - clock.utc().timestamp() if is_calendar else 0.0
    yield Check.of(
        _SUBJECT,
        "its clock",
        abs(rate - 1.0) <= _RATE_TOLERANCE and abs(offset_s) <= _OFFSET_LIMIT_S,
        f"runs at {rate:.4f} of the CAN time stamps; "
        + (f"{offset_s:+.1f} s from this computer's" if is_calendar else "tells no calendar time"),
        "Set this computer's clock (NTP), or let the INS get its time; check time_s of the signal map.",
    )


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    return float(np.polyfit(x - x[0], y - y[0], 1)[0])
