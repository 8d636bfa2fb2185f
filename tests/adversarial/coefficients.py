"""Wrong set-ups of a full calibration: is any coefficient that is off left without a finding or note?

``python -m tests.adversarial.coefficients`` prints the table, ``--table docs/reliability.md`` writes it into
the page. The increments come from :mod:`tests.bench.calibration.rotated_unit`, which is independent of the
estimator; the options are those of a run.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gyrobench.bench.calibration.coefficients import SensorErrors
from gyrobench.bench.calibration.estimator import calibrate
from gyrobench.bench.calibration.increment_recording import IncrementRecording
from gyrobench.bench.calibration.information import BIAS_DRIFT, CalibrationOptions
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, STANDARD_GRAVITY, UG_TO_MPS2
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.error_model import Site
from tests.adversarial.harness import LATITUDES_DEG, SILENT_SIGMAS
from tests.adversarial.strapdown import ARCSEC, Floats
from tests.bench.calibration.rotated_unit import EIGHTEEN, Noise, Unit

_HZ, _RUNS = 10.0, 3
_SPINS = tuple(("inner", angle_deg, rate_dps) for rate_dps in (10.0, 20.0) for angle_deg in (360.0, -360.0))
_HEADER = ("what was done", "runs", "flagged", "silent", "cause named", "largest error, sigma")
_BEGIN, _END = "<!-- wrong coefficients: begin -->", "<!-- wrong coefficients: end -->"


@dataclass
class Log:
    """Increments (n, 3), body axes, with what happened to the unit meanwhile, and what is assumed of it."""

    angle: Floats
    velocity: Floats
    time_s: Floats  #: Shape (n,). Of the middles of the increments.
    attitude: Rotation  #: Of the unit, ENU.
    random: np.random.Generator
    latitude_deg: float  #: As entered.
    gravity: float  #: As entered.
    read_table: Callable[[float], Rotation]  #: Encoders at the ends of the increments, by their scale.
    table: Rotation  #: As read from the encoders.
    interval_s: float = 1.0 / _HZ
    noise: Noise = field(default_factory=Noise)

    def biased(self, rate: Floats) -> Log:
        """With errors of the rates (n, 3), deg/h."""
        return replace(self, angle=self.angle + rate * DPH_TO_RADPS / _HZ)

    def forced(self, force: Floats) -> Log:
        """With errors of the specific forces (n, 3), ug."""
        return replace(self, velocity=self.velocity + force * UG_TO_MPS2 / _HZ)

    def moved(self, vector: Floats) -> Log:
        """With a small rotation (n, 3), rad, of the unit about body axes."""
        turned = self.velocity - np.cross(vector, self.velocity)
        return replace(self, angle=self.angle + np.gradient(vector, axis=0), velocity=turned)

    @property
    def share(self) -> Floats:
        """Shape (n, 1). Time from -0.5 to 0.5."""
        return self.time_s[:, np.newaxis] / self.time_s[-1] - 0.5

    def normal(self, size: float, *shape: int) -> Floats:
        """Random numbers."""
        return size * self.random.standard_normal(shape)


@dataclass(frozen=True)
class Row:
    """A row of the table."""

    name: str
    change: Callable[[Log], Log]
    cause: str = ""  #: Regular expression that names it; empty for any.
    unit: Callable[[np.random.Generator], dict[str, object]] = lambda _: {}  #: Changes of the unit.


def _by_turn_rate(log: Log) -> Log:
    rate_dps = np.degrees(log.angle) * _HZ
    return replace(log, angle=log.angle * (1.0 + 0.5e-6 * np.abs(rate_dps)))


def _magnetic(log: Log) -> Log:
    dip = np.arctan(2.0 * np.tan(np.radians(log.latitude_deg)))
    field_enu = [0.17 * np.cos(dip), 0.98 * np.cos(dip), -np.sin(dip)]
    return log.biased(log.attitude.inv().apply(field_enu) @ log.normal(0.01, 3, 3).T)


def _coning(log: Log) -> Log:
    phase = 2.0 * np.pi * 2.0 * np.r_[log.time_s - 0.5 / _HZ, log.time_s[-1] + 0.5 / _HZ]
    cone = 1e-3 * np.column_stack([np.cos(phase), np.sin(phase), np.zeros(len(phase))])
    away = np.diff(cone, axis=0) - [0.0, 0.0, 0.5 * 1e-6 * 4.0 * np.pi / _HZ]
    return replace(log, angle=log.angle + away)


def _lost(log: Log) -> Log:
    angle, velocity = log.angle.copy(), log.velocity.copy()
    index = int(np.argmax(np.abs(angle).sum(axis=1)))
    angle[index] = velocity[index] = 0.0
    return replace(log, angle=angle, velocity=velocity)


def _wobble(log: Log) -> Log:
    return log.moved(2.0 * ARCSEC * np.sin(2.0 * log.attitude.as_rotvec()))


ROWS = (
    Row("x and y gyros exchanged", lambda log: replace(log, angle=log.angle[:, [1, 0, 2]])),
    Row("z gyro with the wrong sign", lambda log: replace(log, angle=log.angle * [1.0, 1.0, -1.0])),
    Row("all accelerometers with the wrong sign", lambda log: replace(log, velocity=-log.velocity), "sign"),
    Row("one table axis with the wrong sign", lambda log: replace(
        log, angle=log.angle * [1.0, -1.0, 1.0], velocity=log.velocity * [1.0, -1.0, 1.0])),
    Row("angles in deg for rad", lambda log: replace(log, angle=np.degrees(log.angle))),
    Row("sample interval 1 % too long", lambda log: replace(log, interval_s=1.01 / _HZ), "samples"),
    Row("accelerometers delayed by 2 ms", lambda log: log, "delay", lambda _: {"delay_s": 0.002}),
    Row("accelerometers up to 50 mm apart", lambda log: log, "places of the accelerometers",
        lambda random: {"arms": random.uniform(-0.05, 0.05, (3, 3))}),
    Row("unit mounted 1 deg off the table's axes", lambda log: log, "",
        lambda random: {"start": Rotation.from_rotvec(np.radians(random.normal(0.0, 1.0, 3)))}),
    Row("wobble of the table by 2 arcsec", _wobble),
    Row("floor tilts by 5 arcsec in the list", lambda log: log.moved(
        log.attitude.inv().apply(log.share * log.normal(5.0 * ARCSEC, 1, 3) * [1.0, 1.0, 0.0]))),
    Row("quadratic terms of 100 ug/g2", lambda log: log.forced(
        log.normal(100.0, 3) * (log.velocity * _HZ / STANDARD_GRAVITY) ** 2), "quadratic"),
    Row("scale factors that depend on the rate, 10 ppm in 20 deg/s", _by_turn_rate, "depend on the rate"),
    Row("latitude wrong by 0.1 deg", lambda log: replace(
        log, latitude_deg=log.latitude_deg + 0.1), "latitude"),
    Row("gravity wrong by 100 mGal, 30 declared", lambda log: replace(log, gravity=log.gravity + 1e-3)),
    Row("coning by vibration of 1 mrad at 2 Hz", _coning, "cones"),
    Row("gyro biases by a magnetic field, 0.01 deg/h", _magnetic, "magnetic field"),
    Row("gyro biases by the specific force, 0.01 deg/h", lambda log: log.biased(
        log.velocity * _HZ / STANDARD_GRAVITY @ log.normal(0.01, 3, 3).T), "specific force"),
    Row("gyro biases that drift by 0.1 deg/h", lambda log: log.biased(log.share * log.normal(0.1, 3))),
    Row("accelerometer biases that drift by 20 ug", lambda log: log.forced(log.share * log.normal(20.0, 3))),
    Row("accelerometer biases that drift by 5 ug", lambda log: log.forced(log.share * log.normal(5.0, 3))),
    Row("encoder scale wrong by 20 ppm", lambda log: replace(log, table=log.read_table(1.0 + 20e-6)),
        "whole turns"),
    Row("one increment lost in a turn", _lost),
    Row("noise of the gyros 1.6 times the declared", lambda log: replace(
        log, noise=Noise(angle_random_walk=1.6 * Noise.angle_random_walk)), "noise"),
    Row("nothing", lambda log: log),
)  # fmt: skip


def measure(row: Row, runs: int = _RUNS) -> list[str]:
    """Cells of a row of the table."""
    flagged = silent = named = 0
    largest = [0.0]
    for seed in range(runs):
        random = np.random.default_rng([seed, 3])
        log, truth = _log(row, random, LATITUDES_DEG[seed % len(LATITUDES_DEG)])
        text, error = _calibrated(log, truth)
        flagged, named = (
            flagged + bool(text),
            named + bool(text and re.search(row.cause, text, re.IGNORECASE)),
        )
        largest.append(error)
        silent += error > SILENT_SIGMAS and not text
    return [
        row.name,
        str(runs),
        str(flagged),
        str(silent),
        str(named) if row.cause else "",
        f"{max(largest):.1f}",
    ]


def _log(row: Row, random: np.random.Generator, latitude_deg: float) -> tuple[Log, Floats]:
    errors = {
        "gyro_bias": random.normal(0.0, 0.01, 3) * DPH_TO_RADPS,
        "gyro_matrix": random.normal(0.0, 5e-5, (3, 3)),
        "force_bias": random.normal(0.0, 50.0, 3) * UG_TO_MPS2,
        "force_matrix": np.tril(random.normal(0.0, 1e-4, (3, 3))),
    }
    site = Site(np.radians(latitude_deg))
    unit = Unit(
        rotations=(*EIGHTEEN, *_SPINS), dwell_s=120.0, sample_hz=_HZ, latitude_deg=latitude_deg,
        gravity=site.gravity, **errors, **row.unit(random),
    )  # fmt: skip
    angle, velocity = unit.increments()
    time_s = (np.arange(len(angle)) + 0.5) / _HZ

    def read_table(scale: float) -> Rotation:
        return _attitude(unit, time_s + 0.5 / _HZ, scale)

    site_as_entered = latitude_deg, site.gravity
    attitude, table = _attitude(unit, time_s), read_table(1.0)
    log = Log(angle, velocity, time_s, attitude, random, *site_as_entered, read_table, table)
    return row.change(log), SensorErrors(**errors).vector()


def _attitude(unit: Unit, time_s: Floats, encoder_scale: float = 1.0) -> Rotation:
    outer, inner = (each[0] for each in unit.profile(time_s))
    turned = Rotation.from_rotvec(np.outer(inner * encoder_scale, [0.0, 0.0, 1.0]))
    return Rotation.from_rotvec(np.outer(outer, [1.0, 0.0, 0.0])) * turned * unit.start


def _calibrated(log: Log, truth: Floats) -> tuple[str, float]:
    """What is stated about a calibration, and its largest error in standard uncertainties; 0 if refused."""
    noisy = log.noise.added(log.angle, log.velocity, 1.0 / _HZ, log.random)
    options = CalibrationOptions(
        quadratic=None, g_sensitivity=None, gravity=log.gravity, gravity_sigma=3e-4, bias_drift=BIAS_DRIFT,
        latitude_sigma=np.radians(0.1 / 60.0), whole_turns=ARCSEC,
        walks=(Noise.angle_random_walk, Noise.velocity_random_walk),
    )  # fmt: skip
    try:
        recording = IncrementRecording(log.interval_s, *noisy, table=log.table.as_matrix())
        found = calibrate([recording], Site(np.radians(log.latitude_deg)), options)
    except MeasurementError as error:
        return str(error), 0.0
    errors = np.abs(found.values[: len(truth)] - truth) / found.sigmas[: len(truth)]
    is_observed = found.is_observed[: len(truth)]
    return " ".join([*found.findings, *found.notes]), float(errors[is_observed].max())


def main(arguments: Sequence[str] | None = None) -> int:
    """Print or write the table; 1 if a coefficient is silently off."""
    parser = argparse.ArgumentParser(prog="python -m tests.adversarial.coefficients", description=__doc__)
    parser.add_argument("row", nargs="*", help="part of the names of the rows; all without any")
    parser.add_argument("--table", type=Path, help="page into which the table is written")
    options = parser.parse_args(arguments)
    rows = [each for each in ROWS if not options.row or any(part in each.name for part in options.row)]
    cells = []
    for row in rows:
        cells.append(measure(row))
        sys.stdout.write(f"{cells[-1][0]:<60}" + "".join(f"{each:>9}" for each in cells[-1][1:]) + "\n")
        sys.stdout.flush()
    if options.table:
        lines = "\n".join(f"| {' | '.join(each)} |" for each in (_HEADER, ["---"] * len(_HEADER), *cells))
        before, _, rest = options.table.read_text().partition(_BEGIN)
        options.table.write_text(f"{before}{_BEGIN}\n{lines}\n{_END}{rest.partition(_END)[2]}")
    return int(any(each[3] != "0" for each in cells))


if __name__ == "__main__":
    raise SystemExit(main())
