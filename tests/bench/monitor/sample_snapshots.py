"""A run in its middle, made up: every field of the snapshot is filled."""

import math
from dataclasses import replace

from gyrobench.bench.monitor.snapshot import (
    Alarm,
    Attitude,
    BenchReadings,
    CurrentDwell,
    CurrentStep,
    LiveBias,
    LiveBin,
    MeasuredProfile,
    Note,
    PlannedProfile,
    PositionSpan,
    Question,
    RunSnapshot,
    RunState,
    SnapshotDwell,
    WindowTrace,
)

HOUR_S = 3600.0
POSITIONS = ("z_up", "z_down", "y_up", "y_down", "x_up", "x_down")
STOPS_C = (60.0, 20.0, -10.0, -40.0)
STOP_S, RAMP_S = 3 * HOUR_S, HOUR_S


def planned_profile():
    """Four stops of three hours, each position half an hour."""
    time_s, chamber_c, spans = [], [], []
    for number, stop_c in enumerate(STOPS_C):
        start_s = number * (STOP_S + RAMP_S)
        time_s += [start_s, start_s + STOP_S]
        chamber_c += [stop_c, stop_c]
        spans += [
            PositionSpan(start_s + 1800.0 * each, start_s + 1800.0 * (each + 1), position)
            for each, position in enumerate(POSITIONS)
        ]
    return PlannedProfile(tuple(time_s), tuple(chamber_c), tuple(c + 14.0 for c in chamber_c), tuple(spans))


def measured_profile(until_s):
    """Air and gyros that follow the plan, with a gap of an hour."""
    rows = []
    for time_s in range(0, int(until_s), 120):
        stop, into_s = divmod(time_s, STOP_S + RAMP_S)
        at_c = STOPS_C[int(stop)]
        next_c = STOPS_C[min(int(stop) + 1, len(STOPS_C) - 1)]
        set_c = at_c + (next_c - at_c) * max(0.0, (into_s - STOP_S) / RAMP_S)
        gyro_c = set_c + 14.0 - 8.0 * math.exp(-into_s / 2400.0)
        row = (set_c, set_c + 0.3 * math.sin(time_s / 300.0), gyro_c, gyro_c + 0.8, gyro_c - 0.5)
        gap = 5 * HOUR_S < time_s < 5.5 * HOUR_S
        rows.append((float(time_s), *((math.nan,) * 5 if gap else row)))
    return MeasuredProfile(*zip(*rows, strict=True))


def window(until_s, drift=1.0):
    """Velocities of a few mm/s and a heading of some arc seconds, with noise."""
    times = [3.0 * each for each in range(int(until_s / 3.0))]
    wobble = [math.sin(0.7 * t) * 2e-4 for t in times]
    return WindowTrace(
        planned_s=600.0,
        time_s=tuple(times),
        velocity_east_mps=tuple(drift * 1.2e-5 * t + w for t, w in zip(times, wobble, strict=True)),
        velocity_north_mps=tuple(-drift * 7e-6 * t + w for t, w in zip(times, wobble, strict=True)),
        heading_change_deg=tuple(drift * 2.5e-6 * t for t in times),
    )


def measured_dwells(count):
    """Dwells in order, the fifth with a flag."""
    done = []
    for index in range(count):
        position, gyro_c = POSITIONS[index % 6], STOPS_C[index // 6] + 13.0
        bias = (0.003 + 0.002 * (index % 6), -0.001 * (index % 3), 0.0015)
        flagged = index == 4
        done.append(
            SnapshotDwell(
                number=index + 1,
                cycle=1,
                position=position,
                gyro_c=(gyro_c, gyro_c + 0.8, gyro_c - 0.5),
                bias_dph=(math.nan,) * 3 if flagged else bias,
                sigma_dph=(math.nan,) * 3 if flagged else (0.0011,) * 3,
                flags="the INS left navigation in the turn" if flagged else "",
            )
        )
    return tuple(done)


def bins_of(dwells):
    """Bins of 5 K with one dwell each, and empty ones between."""
    bins = []
    for axis, gyro in enumerate("xyz"):
        for position in POSITIONS:
            for low_c in range(-30, 80, 5):
                inside = [
                    d
                    for d in dwells
                    if not d.flags and d.position == position and low_c <= d.gyro_c[axis] < low_c + 5
                ]
                bias = inside[0].bias_dph[axis] if inside else math.nan
                sigma = inside[0].sigma_dph[axis] if inside else math.nan
                bins.append(LiveBin(gyro, position, float(low_c), low_c + 5.0, bias, sigma, len(inside)))
    return tuple(bins)


def made_up_snapshot():
    """Dwell 14 of 24 at -10 degC, its second window half over."""
    now_s = 9.2 * HOUR_S
    dwells = measured_dwells(13)
    estimates = tuple(
        LiveBias(
            now_s - 300.0 + 30.0 * each,
            (0.0052, -0.0011, 0.0016),
            tuple(0.02 / (each + 1) * scale for scale in (1.0, 1.2, 2.0)),
        )
        for each in range(10)
    )
    return RunSnapshot(
        name="six_position-001",
        folder="runs/six_position-001",
        procedure="six_position",
        station="emulated",
        unit="1001",
        started_utc="2026-03-02T07:30:00+00:00",
        updated_utc="2026-03-02T16:42:00+00:00",
        state=RunState.RUNNING,
        now_s=now_s,
        left_s=15.0 * HOUR_S - now_s + 0.2 * HOUR_S,
        planned_s=15.0 * HOUR_S,
        dwell_count=24,
        finished_dwells=len(dwells),
        planned=planned_profile(),
        measured=measured_profile(now_s),
        bench=BenchReadings(
            chamber_set_c=-10.0,
            chamber_c=-9.8,
            gyro_c=(4.1, 4.9, 3.6),
            electronics_c=(12.0, 12.4, 11.8),
            case_c=1.5,
            outer_deg=180.0,
            inner_deg=180.0,
            outer_rate_dps=0.0,
            inner_rate_dps=0.0,
            ins_mode="navigate",
            table_age_s=0.4,
            chamber_age_s=0.6,
            ins_age_s=0.0,
        ),
        attitude=Attitude("z_down", 180.0, ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))),
        step=CurrentStep(212, 325, "cycle 1, -10 degC, z_down", "navigate 10 min", now_s - 300.0, 600.0),
        dwell=CurrentDwell(14, 24, 1, "z_down", (window(600.0), window(300.0, -1.0)), estimates),
        dwells=dwells,
        bins=bins_of(dwells),
        alarms=(),
        messages=(
            Note(4.0 * HOUR_S, "dwell 5 is repeated: the INS left navigation in the turn"),
            Note(6.5 * HOUR_S, "Continuing, by itself"),
        ),
    )


def waiting_snapshot():
    """The same while the chamber does not keep its set point and the operator has to decide."""
    why = "the chamber's air is at 3.2 degC, 13.2 K from its set point. Look at door and compressor."
    return replace(
        made_up_snapshot(),
        state=RunState.WAITING,
        reason=why,
        question=Question(f"The run holds: {why}", ("continue", "abort")),
        dwell=None,
        alarms=(Alarm("chamber_deviation", why), Alarm("rate table", "no reply within 1 s")),
    )


def new_snapshot():
    """A run of which nothing is known yet."""
    return RunSnapshot(
        name="new", folder="runs/new", procedure="", station="", unit="", started_utc="", updated_utc="",
        state=RunState.STARTING, now_s=0.0, left_s=0.0, planned_s=0.0, dwell_count=0,
    )  # fmt: skip
