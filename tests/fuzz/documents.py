"""Documents: procedures, stations, worlds, lists of faults, compensations, DBC files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cantools
import numpy as np

from gyrobench.bench.dwells.measurement_setup import measurement_setup
from gyrobench.bench.engine.job import Job, prepare_job
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.documents import read_document
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.procedure.checks import StationLimits
from gyrobench.bench.procedure.steps import GoTo, Turn
from gyrobench.bench.procedure.timeline import timeline_rows
from gyrobench.bench.runs.compensation_file import read_compensation
from gyrobench.bench.station.instruments import Emulation, Instruments
from gyrobench.bench.station.station import Station
from gyrobench.drivers.emulators.bench import EmulatedBench
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc
from tests.fuzz.checks import WrongResultError, check_document, check_finite, written

#: How often a bench with faults is looked at, and after how long each time.
_LOOKS, _LOOK_S = 4, 150.0


def shipped(kind: str) -> tuple[bytes, ...]:
    """All shipped documents of a kind."""
    some = {"procedures": "quick_campaign", "faults": "every_kind"}.get(kind, "quick")
    folder = find_document(kind, some).parent
    return tuple(path.read_bytes() for path in sorted(folder.glob("*.yaml")))


def dbc_path() -> Path:
    """The shipped DBC file."""
    return Station(find_document("stations", "quick")).dbc_path


def use_procedure(folder: Path, data: bytes) -> None:
    job = prepare_job(str(written(folder, "fuzzed.yaml", data)), "quick")
    check_document(job.document)
    _check_plan(job)


def _check_plan(job: Job) -> None:
    limits: StationLimits = job.station.limits()
    check_finite(
        [(each.start_s, each.duration_s, each.timeout_s) for each in job.plan.steps], "a time of the plan"
    )
    for planned in job.plan.steps:
        step = planned.step
        if planned.duration_s < 0.0:
            raise WrongResultError(f"step {planned.number} takes {planned.duration_s} s")
        temperature_c = getattr(step, "temperature_c", None)
        if temperature_c is not None and not limits.chamber_low_c <= temperature_c <= limits.chamber_high_c:
            raise WrongResultError(f"step {planned.number} goes to {temperature_c} degC")
        if not 0.0 < getattr(step, "ramp_c_per_min", 1e-3) <= max(limits.ramp_max_c_per_min, 1e-3):
            raise WrongResultError(f"step {planned.number} ramps too fast")
        if isinstance(step, GoTo | Turn) and not 0.0 < step.rate_dps <= limits.table_rate_max_dps:
            raise WrongResultError(f"step {planned.number} turns at {step.rate_dps} deg/s")
    list(timeline_rows(job.plan))


def use_station(folder: Path, data: bytes) -> None:
    path = written(folder, "fuzzed.yaml", data)
    job = prepare_job("ten_minute_check", str(path))
    check_document(read_document(path))
    _check_plan(job)
    if job.station.dbc_path.resolve().parent not in (folder.resolve(), dbc_path().parent.resolve()):
        raise WrongResultError(f"the DBC file is {job.station.dbc_path}")
    for limit in measurement_setup(job.station).resolution:
        if not limit.text:
            raise WrongResultError("a resolution without a text")
    if job.station.file.is_emulated():
        with Instruments(job.station, VirtualClock(), Emulation("quick")):
            pass


# Worlds -----------------------------------------------------------------------------------------------------


def use_world(folder: Path, data: bytes) -> None:
    path = written(folder, "fuzzed.yaml", data)
    bench = EmulatedBench(VirtualClock(), path, 0)
    check_document(read_document(path))
    bench.world.power_unit(True)
    bench.clock.sleep(3.0)
    bench.advance()
    check_finite(bench.world.true_gyro_bias(), "the true bias")


def use_faults(folder: Path, data: bytes) -> None:
    """Let the faults come on an emulated bench that is switched on, for as long as the first ones take."""
    path = written(folder, "fuzzed.yaml", data)
    bench = EmulatedBench(VirtualClock(), find_document("worlds", "quick"), 0, path)
    check_document(read_document(path))
    bench.world.power_unit(True)
    for _ in range(_LOOKS):
        bench.clock.sleep(_LOOK_S)
        bench.advance()
    check_finite([each.time_s for each in bench.injected], "the time of a fault")
    check_finite(bench.world.true_gyro_bias(), "the true bias")


COMPENSATION = """\
polynomial_dph: [[0.01, 1.0e-4], [-0.02, 2.0e-4], [0.0, 1.0e-5]]
low_c: [-30, -30, -30]
high_c: [70, 70, 70]
gradient_dph_per_k: [0.001, 0.0, 0.0]
difference_low_k: [5, 5, 5]
difference_high_k: [20, 20, 20]
warm_up_dph: [0.01, 0.02, 0.0]
warm_up_s: [600.0, 600.0, 600.0]
gravity_dph_per_g: [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]]
"""


def use_compensation(folder: Path, data: bytes) -> None:
    path = written(folder, "fuzzed.yaml", data)
    compensation = read_compensation(path)
    document = read_document(path)
    check_document(document)
    for name, value in document.data.items():
        if value is not None and not np.array_equal(
            getattr(compensation, name), np.array(value, dtype=float)
        ):
            raise WrongResultError(f"{name} is {getattr(compensation, name)}")
    prepare_job("ten_minute_check", "quick", compensation=compensation)


def use_dbc(folder: Path, data: bytes) -> None:
    path = written(folder, "fuzzed.dbc", data)
    codec = DbcCodec(load_dbc(path))
    _check_decoding(codec)
    text = find_document("stations", "quick").read_text().replace("gyrobench_ins.dbc", path.name)
    Station(written(folder, "station.yaml", text.encode())).check_dbc()


def _check_decoding(codec: DbcCodec) -> None:
    """Compare bulk decoding with that of cantools."""
    random = np.random.default_rng(0)
    for name in codec.message_names:
        message = codec.database.get_message_by_name(name)
        payloads = random.integers(0, 256, (4, 8), dtype=np.uint8)
        block = FrameBlock.from_columns(
            timestamp_s=np.zeros(4), arbitration_id=np.full(4, codec.arbitration_id(name), np.uint32),
            length=np.full(4, 8, np.uint8), data=payloads,
        )  # fmt: skip
        with np.errstate(all="ignore"):
            decoded = codec.decode(block, name)
        for index, payload in enumerate(payloads):
            try:
                expected = message.decode(payload.tobytes()[: message.length], decode_choices=False)
            except cantools.Error:
                continue
            for signal, exact in expected.items():
                ours, value = decoded[signal][index], _float(exact)
                if not (
                    math.isclose(ours, value, rel_tol=1e-9, abs_tol=1e-300)
                    or math.isnan(ours) == math.isnan(value) is True
                ):
                    raise WrongResultError(f"{name}.{signal} is {ours!r}, cantools says {value!r}")


def _float(value: Any) -> float:
    """The nearest float; cantools multiplies whole numbers without a limit."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf
