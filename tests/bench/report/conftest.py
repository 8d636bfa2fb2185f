"""A made-up run in six positions whose biases part below 50 degC, and what it leaves on disk.

The paper's method reads level gyros wrong by 0.004 deg/h, up or down by the position.
"""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtrc

from gyrobench.bench.bias.bins import BIAS_BINS_TABLE, bin_biases
from gyrobench.bench.bias.dwell_table import DwellRow, write_dwells
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.report.run_report import write_report
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal
from gyrobench.bench.runs.tables.joint_table import (
    JOINT_BIASES_TABLE,
    JOINT_PLATEAUS_TABLE,
    JointBiasRow,
    JointPlateauRow,
)
from gyrobench.bench.runs.tables.noise_file import write_noise
from gyrobench.bench.runs.telemetry import TELEMETRY_COLUMNS, Telemetry
from tests.bench.report.made_up_noise import made_up_noise

CHAMBER_C = (62.0, 47.0, 22.0, 5.0, -8.0, -36.0)
STOP_S = 13_500.0
SIGMA_DPH = 0.0009
LEAK_DPH = 0.004
FREEDOM = 50
SERIAL_NUMBER = "1001"
NOTHING = (math.nan, math.nan, math.nan)


def made_up_dwells(parting_dph=0.008, cycles=2):
    """Six temperatures in each cycle, six positions at each; below 50 degC the biases part."""
    random, paper_random = np.random.default_rng(1), np.random.default_rng(2)
    rows = []
    for cycle in range(1, cycles + 1):
        for stop, chamber_c in enumerate(CHAMBER_C if cycle % 2 else reversed(CHAMBER_C)):
            for place, position in enumerate(POSITIONS):
                start_s = ((cycle - 1) * len(CHAMBER_C) + stop) * STOP_S + 4500.0 + 1500.0 * place
                gyro_c = [chamber_c + 14.0 + 0.4 * axis + random.normal(0.0, 0.1) for axis in range(3)]
                part = [parting_dph * max(0.0, (50.0 - one) / 70.0) for one in gyro_c]
                bias = [
                    0.002 * (axis + 1) + 4e-5 * (gyro_c[axis] - 25.0) + (place - 2.5) / 2.5 * part[axis]
                    for axis in range(3)
                ]
                bias_dph = _triple([one + random.normal(0.0, SIGMA_DPH) for one in bias])
                leak = [(-1) ** place * LEAK_DPH * (axis != place // 2) for axis in (2, 1, 0)]
                apart = np.array(leak) + paper_random.normal(0.0, 0.5 * SIGMA_DPH, 3)
                chi2 = paper_random.chisquare(FREEDOM)
                rows.append(
                    DwellRow(
                        unit=SERIAL_NUMBER,
                        run="1",
                        dwell=len(rows) + 1,
                        cycle=cycle,
                        position=position,
                        start_s=start_s,
                        end_s=start_s + 1228.0,
                        since_power_on_s=start_s - 60.0,
                        gyro_c=_triple(gyro_c),
                        gyro_rate_c_per_h=(0.5, 0.5, 0.5),
                        bias_dph=bias_dph,
                        sigma_dph=(SIGMA_DPH, SIGMA_DPH, 0.8 * SIGMA_DPH),
                        chamber_set_c=chamber_c,
                        chamber_c=chamber_c + 0.1,
                        case_c=chamber_c + 6.0,
                        board_c=_triple([one + 11.0 for one in gyro_c]),
                        paper_bias_dph=_triple(list(bias_dph + apart)),
                        paper_sigma_dph=(1.3 * SIGMA_DPH, 1.3 * SIGMA_DPH, SIGMA_DPH),
                        fit_ratio=math.sqrt(chi2 / FREEDOM),
                        fit_p_value=float(chdtrc(FREEDOM, chi2)),
                    )
                )
    return rows


def without_paper(row):
    """Make the dwell one that the paper's method does not apply to."""
    return replace(row, paper_bias_dph=NOTHING, paper_sigma_dph=NOTHING)


def flagged(row, *reasons):
    """Make the dwell one that gave no bias."""
    nothing = {"bias_dph": NOTHING, "sigma_dph": NOTHING, "fit_ratio": math.nan, "fit_p_value": math.nan}
    return replace(without_paper(row), **nothing, flags=reasons)


def made_up_joint(rows):
    """Biases a tenth better known together, and what each stop and all of them share."""
    stops = sorted({(row.cycle, row.chamber_set_c) for row in rows}, key=lambda key: (key[0], -key[1]))
    biases = [
        JointBiasRow(
            1 + stops.index((row.cycle, row.chamber_set_c)), row.dwell, row.position, gyro, row.gyro_c[axis],
            row.bias_dph[axis], row.sigma_dph[axis], row.bias_dph[axis], 0.9 * row.sigma_dph[axis],
            math.nan, math.nan,
        )
        for row in rows
        for axis, gyro in enumerate("xyz")
    ]  # fmt: skip
    up = (0.0021, 0.0003, -0.6, 0.09, 1e-7, "different")
    shared = [
        JointPlateauRow(
            1 + number,
            cycle,
            6,
            set_c,
            24.0,
            -15.5,
            8.1,
            1.8,
            1.8,
            5.8,
            0.0003,
            0.0008,
            *up,
            0.4 / (1 + number),
            0.5 / (1 + number),
        )
        for number, (cycle, set_c) in enumerate(stops)
    ]
    last = JointPlateauRow(0, 0, len(rows), *[math.nan] * 9, *up, math.nan, math.nan)
    return biases, [*shared, last]


def made_up_telemetry(duration_s, step_s=60.0):
    """A chamber that ramps from stop to stop, and gyros that follow."""
    time_s = np.arange(0.0, duration_s, step_s)
    temperatures = [*CHAMBER_C, *reversed(CHAMBER_C)]
    set_c = np.array([temperatures[min(int(time // STOP_S), len(temperatures) - 1)] for time in time_s])
    air, gyro = np.empty((2, len(time_s)))
    air_c, gyro_c = 23.0, 23.0
    for index, goal in enumerate(set_c):
        air_c += np.clip(goal - air_c, -step_s / 60.0, step_s / 60.0)
        gyro_c += (air_c + 14.0 - gyro_c) * step_s / 2400.0
        air[index], gyro[index] = air_c, gyro_c
    columns = {name: np.zeros(len(time_s)) for name in TELEMETRY_COLUMNS}
    columns |= {"time_s": time_s, "chamber_set_c": set_c, "chamber_c": air, "case_c": gyro - 7.0}
    for number, axis in enumerate("xyz"):
        columns |= {f"gyro_{axis}_c": gyro + 0.4 * number, f"board_{axis}_c": gyro + 11.0 + 0.4 * number}
    return columns


def write_journal(folder, *, ended="finished", reason="", problem=""):
    """Write a short journal with every kind of entry; without an end if ``ended`` is empty."""
    clock = VirtualClock()
    with Journal(folder.journal, clock) as journal:
        journal.record("run_started", procedure="six_position_fig7", station="emulated", options={"seed": 0})
        journal.record("ins_identified", identity="made-up INS, serial number 1001")
        journal.record("resolution", lines=["heading: 0.0001 deg a bit, enough for 0.001 deg/h"])
        steps = [
            ("power_on", "power on, settle 2 min", 120.0, 131.0),
            ("chamber", "chamber to 62 degC at 1 degC/min", 2400.0, 2950.0),
            ("chamber_off", "chamber off", 0.0, 1.0),
            ("navigate", "navigate 10 min", 600.0, 600.0),
            ("ask_operator", "ask: ready?", 60.0, 5.0),
        ]
        for number, (kind, what, planned_s, took_s) in enumerate(steps, start=1):
            journal.record("step_started", step=number, what=what, label="cycle 1, 62 degC")
            clock.sleep(took_s)
            journal.record("step_finished", step=number, kind=kind, planned_s=planned_s, took_s=took_s)
        journal.record("step_started", step=6, what="turn 180 deg", label="cycle 1, 62 degC, z_up")
        if ended:
            safe_state = [
                {"what": "rate table stopped", "problem": problem},
                {"what": "chamber switched off"},
            ]
            journal.record("run_ended", ended=ended, reason=reason, safe_state=safe_state)


def write_run(folder, rows):
    """Write a whole run folder."""
    folder.path.mkdir(parents=True, exist_ok=True)
    write_journal(folder)
    write_dwells(folder.dwells, rows)
    good = [row for row in rows if not row.flags]
    BIAS_BINS_TABLE.write(folder.bias_bins, bin_biases(good))
    biases, stops = made_up_joint(good)
    JOINT_BIASES_TABLE.write(folder.joint_biases, biases)
    JOINT_PLATEAUS_TABLE.write(folder.joint, stops)
    write_noise(folder.noise, made_up_noise())
    telemetry = Telemetry(folder.telemetry)
    columns = made_up_telemetry(max((row.end_s for row in rows), default=3600.0))
    for values in zip(*columns.values(), strict=True):
        telemetry.add(dict(zip(columns, values, strict=True)))
    telemetry.flush()
    folder.procedure.write_text(
        "procedure: six_position_fig7\ndescription: biases in six positions\nassumptions:\n"
        "  - ramp rates are <chosen> here\nbin_width_c: 5\nsteps: []\n",
        encoding="utf-8",
    )
    provenance = {
        "gyrobench": "0.1.0",
        "started_utc": "2000-01-01T00:00:00+00:00",
        "instruments": {"rate table": "Acutrol3000 rev 2.1", "chamber": "Watlow F4 1234"},
        "options": {"seed": 0, "world": "gyro_a"},
        "files_sha256": {"procedure.yaml": "ab" * 32},
        "python": "3.11.7",
        "platform": "Linux",
        "packages": {"numpy": "2.1.0"},
    }
    folder.provenance.write_text(json.dumps(provenance), encoding="utf-8")
    return folder


def _triple(values):
    x, y, z = (float(value) for value in values)
    return x, y, z


@pytest.fixture(scope="session")
def dwells():
    """A run whose positions part, its seventh dwell flagged."""
    rows = made_up_dwells()
    rows[6] = flagged(rows[6], "the INS left navigation during the dwell", "chamber <door> open")
    return rows


@pytest.fixture(scope="session")
def equal_dwells():
    """A run whose positions agree."""
    return made_up_dwells(parting_dph=0.0)


@pytest.fixture(scope="session")
def old_dwells(dwells):
    """The first run as a table states it that knows nothing of estimators."""
    return [replace(without_paper(row), fit_ratio=math.nan, fit_p_value=math.nan) for row in dwells]


@pytest.fixture(scope="session")
def bins(dwells):
    """Bins of the run whose positions part."""
    return bin_biases([row for row in dwells if not row.flags])


@pytest.fixture(scope="session")
def equal_bins(equal_dwells):
    """Bins of the run whose positions agree."""
    return bin_biases(equal_dwells)


@pytest.fixture(scope="session")
def telemetry():
    """Readings that go with the dwells."""
    return made_up_telemetry(162_000.0)


@pytest.fixture(scope="session")
def run_folder(made_once, dwells):
    """A run folder with everything in it, which tests only read."""

    def make(path):
        folder = write_run(RunFolder(path / "six_position_fig7-001"), dwells)
        write_report(folder).path.unlink()  # its figures are drawn once for all tests

    return RunFolder(made_once("made-up-run", make) / "six_position_fig7-001")


@pytest.fixture
def journal_writer():
    """``journal_writer(folder, ended="failed", reason="...", problem="...")``."""
    return write_journal


@pytest.fixture
def empty_folder(tmp_path):
    """A run folder without anything."""
    return RunFolder(tmp_path)
