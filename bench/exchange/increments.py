"""Increments of angle and velocity from a foreign log, for a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrobench.bench.calibration.increment_recording import MIN_REST_TOTAL_S, IncrementRecording
from gyrobench.bench.calibration.information import CalibrationOptions
from gyrobench.bench.exchange.import_map import LogMap
from gyrobench.bench.exchange.log_windows import FORCES, RATES, SampleReader
from gyrobench.bench.exchange.signal_logs import NoFramesError
from gyrobench.bench.foundations.arrays import (
    DEG_PER_SQRT_H_TO_SI,
    RAD_TO_ARCMIN,
    S_PER_H,
    UG_PER_SQRT_HZ_TO_SI,
    BoolArray,
    FloatArray,
    IntArray,
    true_spans,
)
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.error_model import Site
from gyrobench.drivers.ins.units import UNITS, Dimension

#: Specific force and its increments in SI units.
_FORCE_UNITS = UNITS[Dimension.ACCELERATION] | UNITS[Dimension.SPEED]
_VELOCITY_INCREMENTS = ("m/s", "mm/s")
#: Samples over which the usual interval is measured, samples on each side over which a jump of the time is
#: measured, and smallest deviation of a gap's step from the usual interval, relative.
_INTERVAL_SAMPLES, _JUMP_SAMPLES, _MIN_STEP_ERROR = 100, 16, 0.3
#: Share of samples with the time stamp of the previous sample, above which stamps are coarser than samples.
_MAX_EQUAL_STAMPS = 0.3
#: An axis is saturated if at least this number of samples in a row, over at least this time, s, have its
#: extreme value, while at most this share of the other samples repeat the previous one.
_MIN_SATURATED, _MIN_SATURATED_S, _MAX_REPEATED = 12, 0.1, 0.3


@dataclass(frozen=True, eq=False)
class LogIncrements:
    """Increments of one log."""

    recordings: list[IncrementRecording]  #: Parts of the log without a missing sample.
    samples: int  #: Number of samples in the log.
    #: Relative standard uncertainty of the time between samples, from the scatter of the time stamps.
    interval_error: float

    @property
    def left_out(self) -> int:
        """Samples that are missing, not numbers, repeated, or in a part that is too short."""
        return self.samples - sum(len(each.angle) for each in self.recordings)


def read_increments(path: Path, log_map: LogMap) -> LogIncrements:
    """Read a log, divided at missing samples; parts that rest for less than a minute are left out.

    Rates and specific forces are taken as means since the previous sample. Raises DocumentError if the log
    can't be read, or does not fit the map. Raises MeasurementError if no part is long enough.
    """
    section = log_map.calibrated
    angle_unit, angles_are_increments = _angle_unit(log_map.gyro.unit)
    quantities = log_map.gyro.by_quantity(RATES, angle_unit)
    quantities |= section.accelerometers.by_quantity(FORCES, _FORCE_UNITS[section.accelerometers.unit][0])
    velocities_are_increments = section.accelerometers.unit in _VELOCITY_INCREMENTS
    reader = SampleReader(path, log_map, quantities, angles_are_increments or velocities_are_increments)
    samples = reader.whole()
    is_kept = samples["time_s"] >= samples["time_s"][:1] + log_map.skip_s
    samples = {name: values[is_kept] for name, values in samples.items()}
    time_s = samples["time_s"]
    full_scale = np.inf if log_map.gyro.full_scale is None else log_map.gyro.full_scale * angle_unit
    for name, (column, _, _) in quantities.items():
        index = _saturation_index(time_s, samples[name], full_scale if name in RATES else np.inf)
        if index is not None:
            raise MeasurementError(
                f"{path}: column {column!r} stays at the end of its range from {time_s[index]:.2f} s after "
                "the first sample: the sensor or its number format is saturated. Record slower rotations, or "
                "cut the log there"
            )
    angle, velocity = (np.column_stack([samples[name] for name in names]) for names in (RATES, FORCES))
    recordings, errors, parts = [], [0.0], _complete_parts(time_s, np.hstack([angle, velocity]))
    for part in parts:
        if time_s[part[-1]] - time_s[part[0]] < MIN_REST_TOTAL_S:
            continue
        first_s, interval_s, error = _even_times(time_s[part])
        errors.append(error / interval_s)
        recordings.append(
            IncrementRecording(
                interval_s,
                angle[part] * (1.0 if angles_are_increments else interval_s),
                velocity[part] * (1.0 if velocities_are_increments else interval_s),
                reader.first_s + first_s - interval_s,
            )
        )
    if not recordings:
        raise MeasurementError(f"{path}: {_no_part_reason(time_s, parts)}")
    # A part with too few rests contributes nothing; if no part has enough, the estimator reports it.
    resting = [each for each in recordings if _has_rests(each)] if len(recordings) > 1 else recordings
    return LogIncrements(resting or recordings, len(time_s), max(errors))


def _has_rests(recording: IncrementRecording) -> bool:
    """Whether a recording has rests that are long enough."""
    try:
        return bool(recording.rests)
    except MeasurementError:
        return False


def read_logs(paths: Sequence[Path], log_map: LogMap) -> list[LogIncrements]:
    """Read several logs; parts of a run's log without a frame of the sensors yield no sample.

    Raises as :func:`read_increments`, also if no log has such a frame.
    """
    logs: list[LogIncrements] = []
    for path in paths:
        try:
            logs.append(read_increments(path, log_map))
        except NoFramesError:
            if path == paths[-1] and not any(log.samples for log in logs):
                raise
            logs.append(LogIncrements([], 0, 0.0))
    return logs


def _even_times(time_s: FloatArray) -> tuple[float, float, float]:
    """First time and interval of equal steps fitted to time stamps, and the interval's standard uncertainty.

    All in s. All time stamps are used, since a single one may be late.
    """
    index = np.arange(len(time_s)) - 0.5 * (len(time_s) - 1)
    squares = float(index @ index)
    interval_s, middle_s = float(index @ time_s) / squares, float(time_s.mean())
    residual_s = time_s - middle_s - interval_s * index
    scatter_s = np.sqrt(float(residual_s @ residual_s) / max(len(time_s) - 2, 1))
    return middle_s + interval_s * float(index[0]), interval_s, float(scatter_s / np.sqrt(squares))


def _no_part_reason(time_s: FloatArray, parts: Sequence[IntArray]) -> str:
    """Reason why a log has no part that is long enough."""
    if len(time_s) > 1 and np.mean(np.diff(time_s) == 0.0) > _MAX_EQUAL_STAMPS:
        return (
            "its time stamps are coarser than its samples. State the rate of the samples in the map in place "
            "of the column of times: time: {sample_rate_hz: ...}"
        )
    length_s = float(time_s[-1] - time_s[0]) if len(time_s) else 0.0
    gaps = f"; missing samples cut it into {len(parts)} parts" if len(parts) > 1 else ""
    return (
        f"{length_s:.4g} s of samples{gaps}; at least {MIN_REST_TOTAL_S:g} s without a missing sample are "
        "needed. Check the log and 'time' in its map"
    )


def _angle_unit(unit: str) -> tuple[float, bool]:
    """Size of a unit of rate or angle in rad/s or rad, and whether it is a unit of increments."""
    angle, _, per = unit.partition("/")
    return UNITS[Dimension.ANGLE][angle][0] / (S_PER_H if per == "h" else 1.0), not per


def _complete_parts(time_s: FloatArray, values: FloatArray) -> list[IntArray]:
    """Indices of the samples of each part of a log without a missing sample; repeated rows are left out.

    Gaps are jumps of the time as a function of the sample's index, averaged to suppress jitter of the stamps.
    """
    lag = min(_INTERVAL_SAMPLES, len(time_s) - 1)
    if lag < 1:
        return []
    usual_s = float(np.median(time_s[lag:] - time_s[:-lag])) / lag
    is_repeated = (np.diff(time_s) < 0.5 * usual_s) & (values[1:] == values[:-1]).all(axis=1)
    kept_indices = np.flatnonzero(np.concatenate([[True], ~is_repeated]))
    index, count = np.arange(1, len(kept_indices)), len(kept_indices)
    deviation_s = np.concatenate([[0.0], np.cumsum(time_s[kept_indices] - usual_s * np.arange(count))])
    first, last = np.maximum(index - _JUMP_SAMPLES, 0), np.minimum(index + _JUMP_SAMPLES, count)
    jump_s = (deviation_s[last] - deviation_s[index]) / (last - index) - (
        deviation_s[index] - deviation_s[first]
    ) / (index - first)
    is_gap = (np.abs(jump_s) > 0.5 * usual_s) & (
        np.abs(np.diff(time_s[kept_indices]) - usual_s) > _MIN_STEP_ERROR * usual_s
    )
    valid: BoolArray = np.asarray(np.isfinite(values[kept_indices]).all(axis=1))
    is_joined = valid[1:] & valid[:-1] & ~is_gap
    return [kept_indices[begin : end + 1] for begin, end in true_spans(is_joined)]


def _saturation_index(time_s: FloatArray, values: FloatArray, limit: float) -> int | None:
    """Index of the first saturated sample of an axis (n,); None if there is none.

    A saturated axis reaches the ``limit``, or stays exactly at its largest or smallest value, unlike a sensor
    whose noise changes its output from sample to sample.
    """
    if (at_limit := np.flatnonzero(np.abs(values) >= limit * (1.0 - 1e-6))).size:
        return int(at_limit[0])
    for extreme in (np.nanmax(values), np.nanmin(values)) if np.isfinite(values).any() else ():
        is_extreme = values == extreme
        is_free = ~is_extreme[1:] & ~is_extreme[:-1]
        if not is_free.any() or np.mean(values[1:][is_free] == values[:-1][is_free]) > _MAX_REPEATED:
            continue
        for begin, end in true_spans(is_extreme):
            if end - begin >= _MIN_SATURATED and time_s[end - 1] - time_s[begin] >= _MIN_SATURATED_S:
                return int(begin)
    return None


def calibration_settings(log_map: LogMap, interval_error: float = 0.0) -> tuple[Site, CalibrationOptions]:
    """Site and options of a calibration, from the import map.

    ``interval_error``: relative standard uncertainty of the time between samples, from their time stamps.
    """
    section = log_map.calibrated
    turns, noise = section.whole_turns_arcsec, section.noise
    walks = None
    if noise is not None:
        walks = (
            noise.angle_random_walk_deg_per_sqrt_h * DEG_PER_SQRT_H_TO_SI,
            noise.velocity_random_walk_ug_per_sqrt_hz * UG_PER_SQRT_HZ_TO_SI,
        )
    whole_turns = None if turns is None else turns * UNITS[Dimension.ANGLE]["arcsec"][0]
    time_error = float(np.hypot(1e-6 * section.clock_sigma_ppm, interval_error))
    _, angles_are_increments = _angle_unit(log_map.gyro.unit)
    velocities_are_increments = section.accelerometers.unit in _VELOCITY_INCREMENTS
    return section.site, CalibrationOptions(
        whole_turns=whole_turns,
        gravity=section.gravity_mps2,
        walks=walks,
        gravity_sigma=section.gravity_sigma,
        latitude_sigma=section.latitude_uncertainty_arcmin / RAD_TO_ARCMIN,
        scales_by_time=(
            0.0 if angles_are_increments else time_error,
            -time_error if velocities_are_increments else 0.0,
        ),
    )
