"""Whole runs in real time, the emulators in processes of their own, over slcan and socketcand side by side.

Table and chamber are on pseudo-terminals, or on TCP ports where the CAN bus is a socketcand server.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import yaml

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.folder import open_run_folder
from gyrobench.bench.runs.journal import read_journal
from tests.soak.results import PartResult, PartTable, machine
from tests.soak.served_bench import FRAME, packed
from tests.soak.truth import Agreement, true_bias_dph

_GYROBENCH = str(Path(sys.executable).with_name("gyrobench"))
_WORLD = "ideal"
_BUSES = ("slcan", "socketcand")
_SAMPLE_S = 1.0
#: A dwell beside its two navigations, and the run beside its dwells.
_AROUND_S, _BEGIN_AND_END_S = 75.0, 20.0
_POSITIONS = ("z_up", "y_down", "x_up")
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


@dataclass
class Usage:
    """Processor time of a process, in s of processor time and of real time."""

    busy_s: float = 0.0
    lasted_s: float = 0.0

    def percent(self) -> str:
        """Share of one core."""
        return f"{100.0 * self.busy_s / self.lasted_s:.1f} %" if self.lasted_s else "-"


def procedure_text(minutes: float) -> str:
    """Dwells in three positions that last ``minutes`` together."""
    navigate_s = max(61.0, (60.0 * minutes - _BEGIN_AND_END_S) / (2 * len(_POSITIONS)) - _AROUND_S / 2.0)
    return (
        "procedure: soak_real_time\nsteps:\n  - power_on\n  - repeat:\n"
        f"      over: {{position: [{', '.join(_POSITIONS)}]}}\n      steps:\n"
        "        - go_to: {position: $position, rate_dps: 30, settle_s: 2}\n"
        "        - align: {duration_s: 42}\n"
        f"        - navigate: {{duration_s: {navigate_s:.0f}}}\n"
        "        - turn: {angle_deg: 180, rate_dps: 30, settle_s: 2}\n"
        f"        - navigate: {{duration_s: {navigate_s:.0f}}}\n"
    )


def station_text(urls: Mapping[str, str], bus: str) -> str:
    """The shipped station with the ports of a served bench."""
    station = yaml.safe_load(find_document("stations", "emulated").read_text())
    station |= {"clock": "wall", "tick_s": 1.0, "poll_period_s": 0.1, "instruments_period_s": 2.0}
    station["rate_table"]["port"], station["chamber"]["port"] = urls["table"], urls["chamber"]
    ins = station["ins"] | {"interface": bus}
    if bus == "slcan":
        ins |= {"channel": urls["ins"], "options": {"sleep_after_open": 0.1}}
    else:
        where = urlsplit(urls["ins"])
        ins |= {"channel": where.path.strip("/"), "options": {"host": where.hostname, "port": where.port}}
        del ins["bitrate"]
    return yaml.safe_dump(station | {"ins": ins})


def real_time(folder: Path, minutes: float, seed: int) -> PartResult:
    """Run for ``minutes`` of real time on each kind of bus, side by side."""
    with ThreadPoolExecutor(len(_BUSES)) as pool:
        runs = list(pool.map(lambda bus: _one(folder / bus, bus, minutes, seed), _BUSES))
    names = list(dict.fromkeys(name for figures, _ in runs for name in figures))
    return PartResult(
        "real_time",
        "In real time",
        {
            name: " / ".join(dict.fromkeys(figures[name] for figures, _ in runs))
            for name in names
            if not name.startswith("processor")
        },
        f"Two benches of the world `{_WORLD}` side by side, an epoch of the INS every 0.1 s: "
        "`gyrobench run` with its guard, and the emulators in a separate process. A tick's lateness is "
        "written by every run at the end of its journal. Frames are compared one by one with what the "
        "emulated INS sent. Processor load is that of one core, from the first step on.",
        [PartTable(["", *_BUSES], [[name, *(figures[name] for figures, _ in runs)] for name in names])],
        [problem for _, problems in runs for problem in problems],
        machine(),
    )


def _one(folder: Path, bus: str, minutes: float, seed: int) -> tuple[dict[str, str], list[str]]:
    folder.mkdir(parents=True, exist_ok=True)
    frames, run = folder / "sent.bin", folder / "run"
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    serve = [
        sys.executable,
        "-m",
        "tests.soak.served_bench",
        str(frames),
        "--world",
        _WORLD,
        "--seed",
        str(seed),
    ]
    options = ["--tcp", "--can", "socketcand"] if bus == "socketcand" else []
    with subprocess.Popen([*serve, *options], stdout=subprocess.PIPE, text=True, env=environment) as server:
        assert server.stdout
        urls = json.loads(server.stdout.readline())
        (folder / "station.yaml").write_text(station_text(urls, bus))
        (folder / "procedure.yaml").write_text(procedure_text(minutes))
        command = [
            _GYROBENCH,
            "run",
            str(folder / "procedure.yaml"),
            "--station",
            str(folder / "station.yaml"),
        ]
        with (folder / "printed.txt").open("w") as printed:
            begin_s = time.monotonic()
            process = subprocess.Popen(
                [*command, "--out", str(run)], stdout=printed, stderr=printed, env=environment
            )
            usage = _watched(process, server.pid, run / "journal.jsonl")
        lasted_s = time.monotonic() - begin_s
        server.terminate()
    return _figures(run, frames, usage, lasted_s, process.returncode, bus)


def _watched(process: subprocess.Popen[bytes], server: int, journal: Path) -> dict[str, Usage]:
    """Processor time of bench, guard and emulators from the first step to the end of the plan."""
    first: dict[str, tuple[float, float]] = {}
    last: dict[str, tuple[float, float]] = {}
    while process.poll() is None:
        text = journal.read_text() if journal.exists() else ""
        if '"step_started"' in text and '"run_ended"' not in text:
            for name, pid in {
                "bench": process.pid,
                "guard": _child(process.pid),
                "emulators": server,
            }.items():
                busy_s = _busy_s(pid)
                if busy_s is not None:
                    last[name] = (time.monotonic(), busy_s)
                    first.setdefault(name, last[name])
        time.sleep(_SAMPLE_S)
    return {
        name: Usage(last[name][1] - first[name][1], last[name][0] - first[name][0])
        for name in ("bench", "guard", "emulators")
        if name in first
    }


def _child(pid: int) -> int | None:
    """The guard is the bench's only child."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return None
    return int(children[0]) if children else None


def _busy_s(pid: int | None) -> float | None:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return (int(fields[11]) + int(fields[12])) / _TICKS_PER_S


def _figures(
    run: Path, sent_file: Path, usage: Mapping[str, Usage], lasted_s: float, code: int, bus: str
) -> tuple[dict[str, str], list[str]]:
    folder = open_run_folder(run)
    entries = list(read_journal(folder.journal))
    ticks: dict[str, Any] = next((entry for entry in reversed(entries) if entry["event"] == "ticks"), {})
    finished = [entry for entry in entries if entry["event"] == "dwell_finished"]
    logged = b"".join(packed(each) for _, part in read_can_log(folder.can) for each in part.messages())
    sent = sent_file.read_bytes()
    # What the INS sends after the bench has left is not for it.
    is_whole = sent.startswith(logged)
    agreement = Agreement()
    for row in read_dwells(folder.dwells):
        agreement.add(row, true_bias_dph(row.gyro_c, find_document("worlds", _WORLD)), bus)
    lost_epochs = sum(entry["epochs"]["lost"] for entry in finished)
    problems = [f"{bus}: {each}" for each in agreement.wrong]
    if code:
        problems.append(f"{bus}: the run ended with exit code {code}: {entries[-1].get('reason')}")
    if not is_whole:
        problems.append(f"{bus}: the frames in the log are not those that were sent, in their order")
    if lost_epochs:
        problems.append(f"{bus}: {lost_epochs} epochs lost")
    figures = {
        "lasted": f"{lasted_s / 60.0:.1f} min",
        "ticks": str(ticks.get("count")),
        "ticks missed": str(ticks.get("missed")),
        "tick late, median": _ms(ticks.get("late_median_s")),
        "tick late, 99 %": _ms(ticks.get("late_99_percent_s")),
        "tick late, at most": _ms(ticks.get("late_max_s")),
        "frames received": str(len(logged) // FRAME.size),
        "frames lost": "0" if is_whole else "some",
        "epochs lost": str(lost_epochs),
        "dwells": f"{len(finished)}, {agreement.flagged} flagged",
        "wrong results let through": str(len(agreement.wrong)),
        **{f"processor, {name}": each.percent() for name, each in usage.items()},
    }
    return figures, problems


def _ms(value_s: float | None) -> str:
    return "-" if value_s is None else f"{1000.0 * value_s:.1f} ms"
