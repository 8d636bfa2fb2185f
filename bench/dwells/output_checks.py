"""Checks for output that is impossible at rest: values that stay constant, and values that jump.

At rest velocity and attitude move smoothly, only by noise and according to the error model. A corrupted
frame, a restart of the INS or a knock against the unit causes a jump from one epoch to the next. A stuck
output is constant to the last bit for longer than the declared noise allows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.bias.dwell import NavigationWindow, RestOutput
from gyrobench.bench.bias.noise_model import NoiseModel, rounding_sigma
from gyrobench.bench.bias.window_filter import EPOCH_S
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.navigation.attitude import rotation_vector_enu
from gyrobench.bench.navigation.earth import EARTH_RATE, MEAN_RADIUS

#: A value jumps if it deviates from its neighbours by more than this number of robust standard deviations
#: plus this number of steps of the output.
_JUMP_SIGMAS, _JUMP_STEPS = 10.0, 4.0
_MAD_TO_SIGMA = 1.4826
#: It does not jump within this number of sigmas of white noise: pulses without dither are mostly constant.
_WHITE_SIGMAS = 5.5
#: More jumps than this in a window are steps of the output.
_MAX_SINGLE_JUMPS = 30
#: Times, s, over which a change of slope is tested; its largest size in standard deviations; and the fewest
#: such times in a window.
_BEND_LAGS_S, _BEND_SIGMAS, _MIN_LAGS = (10.0, 30.0), 6.5, 3.0
#: Smallest singular value, relative to the largest, in the fit of the error model to a channel.
_MIN_SHARE = 1e-6
#: Longest time that an output may be constant, as a multiple of the time in which its random walk has a
#: standard deviation of one step; a random walk exceeds it once in ten thousand million times.
_STUCK_TIMES = 6.0
#: An output counts as stuck only after this number of epochs and this time, s.
_MIN_STUCK_EPOCHS, _MIN_STUCK_S = 30, 10.0
#: An INS is as noisy as declared if its attitude moves by this share of the expected amount over this time,
#: s. The velocity of a less noisy INS may well be constant for minutes.
_MIN_MOTION_SHARE, _MOTION_LAG_S = 0.5, 10.0
#: An INS is noisier than declared if its mean square motion exceeds the expected one by this factor.
_MAX_MOTION_RATIO = 1.25
_VELOCITIES = ("velocity East", "velocity North")
_ATTITUDE = ("attitude about East", "attitude about North", "heading")
#: Rounding of the arithmetic: m/s and rad.
_ARITHMETIC = 1e-11


@dataclass(frozen=True)
class OutputFault:
    """Message about a fault, and whether noise larger than declared would explain it."""

    text: str
    may_be_noise: bool = False


def output_faults(
    windows: Sequence[NavigationWindow],
    noise: NoiseModel,
    gravity: float,
    velocity_step_mps: float,
    heading_step_rad: float,
) -> list[OutputFault]:
    """Find faults of the output in the windows of a dwell, given with all their epochs.

    ``gravity`` in m/s^2; ``velocity_step_mps``, ``heading_step_rad``: resolution of the output.
    """
    steps = dict.fromkeys(_VELOCITIES, velocity_step_mps) | dict.fromkeys(_ATTITUDE, heading_step_rad)
    channels = [_channels(window) for window in windows]
    has_declared_noise = any(
        _moves_as_declared(window.time_s, each, noise.angle_random_walk)
        for window, each in zip(windows, channels, strict=True)
    )
    faults = []
    for number, (window, each) in enumerate(zip(windows, channels, strict=True), start=1):
        window_faults = [
            _jump_fault(window.time_s, each, steps, noise),
            _bend_fault(window, steps, noise, gravity),
            _stuck_fault(window.time_s, each, steps, noise) if has_declared_noise else None,
        ]
        faults += [replace(fault, text=f"window {number}: {fault.text}") for fault in window_faults if fault]
    return faults


def _channels(window: NavigationWindow) -> dict[str, FloatArray]:
    rotation = rotation_vector_enu(window.C_nb, window.C_nb[0])
    velocities = dict(zip(_VELOCITIES, window.velocity_enu_mps.T, strict=False))
    return velocities | dict(zip(_ATTITUDE, rotation.T, strict=True))


def _jump_fault(
    time_s: FloatArray, channels: Mapping[str, FloatArray], steps: Mapping[str, float], noise: NoiseModel
) -> OutputFault | None:
    """Fault if any channel jumps, with the time of the first jump."""
    white = dict.fromkeys(_VELOCITIES, noise.velocity_white) | dict.fromkeys(_ATTITUDE, noise.heading_white)
    jumps = {
        name: _first_jump(time_s, values, steps[name], _WHITE_SIGMAS * white[name])
        for name, values in channels.items()
    }
    first_name = min(jumps, key=lambda name: jumps[name][0])
    first_s, count, size = jumps[first_name]
    if not math.isfinite(first_s):
        return None
    if count > _MAX_SINGLE_JUMPS:
        unit = "m/s" if first_name in _VELOCITIES else "rad"
        return OutputFault(
            f"the {first_name} moves in steps of about {size:.1g} {unit}, {count} of them: the resolution of "
            "the sensors limits the dwell, or frames are damaged. Dither the gyros; check the raw CAN log"
        )
    return OutputFault(
        f"the {first_name} jumps at {first_s:.1f} s on the clock of the INS: a damaged frame, an INS that "
        "restarted, or a unit that was knocked. Check the raw CAN log"
    )


def _bend_fault(
    window: NavigationWindow, steps: Mapping[str, float], noise: NoiseModel, gravity: float
) -> OutputFault | None:
    """Fault if the slope of any channel changes by more than error model and noise explain."""
    for lag_s in _BEND_LAGS_S:
        for name, (middle_s, bends, sigma) in _slope_changes(window, steps, noise, gravity, lag_s).items():
            deviations = np.abs(bends)
            if deviations.max() > _BEND_SIGMAS * sigma:
                robust_sigma = _MAD_TO_SIGMA * float(np.median(deviations))
                may_be_noise = bool(deviations.max() <= _BEND_SIGMAS * robust_sigma)
                return OutputFault(
                    f"the {name} bends within {lag_s:g} s of {middle_s[np.argmax(deviations)]:.1f} s on the "
                    "clock of the INS by more than its noise explains: was the unit moved?",
                    may_be_noise,
                )
    return None


def _slope_changes(
    window: NavigationWindow, steps: Mapping[str, float], noise: NoiseModel, gravity: float, lag_s: float
) -> dict[str, tuple[FloatArray, FloatArray, float]]:
    """Change of slope of the residual of each channel about the error model; empty for short windows.

    For each channel: times (n,), the changes over a lag before and after them (n,), and their standard
    deviation.
    """
    thinned = window.thinned(EPOCH_S)
    time_s = thinned.time_s
    if time_s[-1] - time_s[0] < _MIN_LAGS * lag_s:
        return {}
    channels = _channels(thinned)
    explained = _error_model(time_s - time_s[0], gravity)
    values = np.array([*channels.values()]).T
    # An offset as large as the Earth's rotation must not limit the accuracy of the fit.
    values = values - values.mean(axis=0)
    values = values - explained @ np.linalg.lstsq(explained, values, rcond=_MIN_SHARE)[0]
    middle_s = time_s[(time_s >= time_s[0] + lag_s) & (time_s <= time_s[-1] - lag_s)]
    result = {}
    for name, residual in zip(channels, values.T, strict=True):
        before, middle, after = (
            np.interp(middle_s + away_s, time_s, residual) for away_s in (-lag_s, 0.0, lag_s)
        )
        if name in _VELOCITIES:
            walk, white = noise.velocity_random_walk, noise.velocity_white
            tilt_variance = (gravity * noise.angle_random_walk) ** 2 * lag_s**3 * 2.0 / 3.0
        else:
            walk, white, tilt_variance = noise.angle_random_walk, noise.heading_white, 0.0
        white = max(white, steps[name] / math.sqrt(12.0))
        sigma = math.sqrt(2.0 * walk**2 * lag_s + 6.0 * white**2 + tilt_variance)
        result[name] = middle_s, before - 2.0 * middle + after, sigma
    return result


def _error_model(time_s: FloatArray, gravity: float) -> FloatArray:
    """Functions of time (n, 9) that the error model allows at rest: Schuler loop, rotation of the Earth."""
    schuler = math.sqrt(gravity / MEAN_RADIUS) * time_s
    oscillation = np.array([np.sin(schuler), np.cos(schuler)])
    # The Earth's rotation splits the Schuler frequency a little.
    earth = [np.sin(EARTH_RATE * time_s), np.cos(EARTH_RATE * time_s)]
    share = time_s / time_s[-1]
    return np.array([np.ones(len(time_s)), share, share**2, *oscillation, *(share * oscillation), *earth]).T


def exceeds_noise(
    windows: Sequence[NavigationWindow],
    noise: NoiseModel,
    gravity: float,
    velocity_step_mps: float,
    heading_step_rad: float,
) -> bool:
    """Whether velocities or attitude move more than this noise explains; see :func:`output_faults`."""
    steps = dict.fromkeys(_VELOCITIES, velocity_step_mps) | dict.fromkeys(_ATTITUDE, heading_step_rad)
    bends = [_slope_changes(window, steps, noise, gravity, _MOTION_LAG_S) for window in windows]
    for names in (_VELOCITIES, _ATTITUDE):
        squares = [
            float(np.mean((each[name][1] / each[name][2]) ** 2)) for each in bends for name in names if each
        ]
        if squares and float(np.mean(squares)) > _MAX_MOTION_RATIO:
            return True
    return False


def rounding(
    rests: Sequence[RestOutput], velocity_step_mps: float, heading_step_rad: float
) -> tuple[float, float]:
    """Standard uncertainties of velocity, m/s, and heading, rad, due to rounding, at one epoch per second."""
    velocities, headings = [], []
    for rest in rests:
        if len(rest.time_s) > 1:
            every = max(1, round(EPOCH_S / float(np.median(np.diff(rest.time_s)))))
            velocities += [*rest.velocity_enu_mps[::every, :2].T]
            headings.append(rotation_vector_enu(rest.C_nb[::every], rest.C_nb[0])[:, 2])
    sigmas = []
    for channels, step in ((velocities, velocity_step_mps), (headings, heading_step_rad)):
        changes = sum(1 + np.count_nonzero(np.abs(np.diff(each)) > _ARITHMETIC) for each in channels)
        sigmas.append(rounding_sigma(step, sum(map(len, channels)) / max(changes, 1)))
    return sigmas[0], sigmas[1]


def _stuck_fault(
    time_s: FloatArray, channels: Mapping[str, FloatArray], steps: Mapping[str, float], noise: NoiseModel
) -> OutputFault | None:
    """Fault if an output stays the same for longer than its noise allows."""
    pulse = math.sqrt(12.0) * noise.heading_white
    steps = {name: max(step, pulse) if name in _ATTITUDE else step for name, step in steps.items()}
    move_masks = {
        name: _has_moved(values, max(steps[name], _ARITHMETIC)) for name, values in channels.items()
    }
    walks = {"heading": noise.angle_random_walk} | dict.fromkeys(_VELOCITIES, noise.velocity_random_walk)
    longest_s = {
        name: max(_MIN_STUCK_S, _STUCK_TIMES * (max(steps[name], _ARITHMETIC) / walk) ** 2)
        if walk
        else math.inf
        for name, walk in walks.items()
    }
    # The whole output is constant at most as long as the channel that passes its steps the fastest.
    move_masks["whole output"] = np.any(list(move_masks.values()), axis=0)
    longest_s["whole output"] = min(longest_s.values())
    for name, limit_s in longest_s.items():
        begin_s, constant_s = _longest_constant(time_s, move_masks[name])
        if constant_s > limit_s:
            return OutputFault(
                f"the {name} stays the same for {constant_s:.0f} s from {begin_s:.1f} s on the clock of the "
                "INS, longer than its noise allows: the output is stuck. Restart the INS"
            )
    return None


def _moves_as_declared(time_s: FloatArray, channels: Mapping[str, FloatArray], walk: float) -> bool:
    """Whether any angle moves about as much as its declared random walk predicts."""
    lag = max(1, round(_MOTION_LAG_S / float(np.median(np.diff(time_s)))))
    expected = walk * math.sqrt(2.0 * _MOTION_LAG_S)
    angles = [channels[name] for name in _ATTITUDE]
    bends = [each[2 * lag :] - 2.0 * each[lag:-lag] + each[: -2 * lag] for each in angles]
    return any(len(each) > 0 and float(np.std(each)) > _MIN_MOTION_SHARE * expected for each in bends)


def _first_jump(
    time_s: FloatArray, values: FloatArray, step: float, white: float
) -> tuple[float, int, float]:
    """Time of the first value that neither its neighbours nor white noise explain; infinite if there is none.

    Also returns the number of such values, and their median deviation.
    """
    before_s, after_s = time_s[1:-1] - time_s[:-2], time_s[2:] - time_s[1:-1]
    expected = (values[:-2] * after_s + values[2:] * before_s) / (before_s + after_s)
    deviations = values[1:-1] - expected
    # Across lost epochs a random walk grows with the square root of the time.
    gap_factors = np.sqrt((before_s + after_s) / (2.0 * np.median(after_s)))
    sigma = _MAD_TO_SIGMA * float(np.median(np.abs(deviations)))
    jumps = np.abs(deviations) > (max(_JUMP_SIGMAS * sigma, white) + _JUMP_STEPS * step) * np.maximum(
        gap_factors, 1.0
    )
    if not jumps.any():
        return math.inf, 0, 0.0
    return float(time_s[1:-1][jumps][0]), int(jumps.sum()), float(np.median(np.abs(deviations[jumps])))


def _has_moved(values: FloatArray, step: float) -> BoolArray:
    """Whether each value except the first differs by half a step from the one before, or since its last move.

    A floating-point number near zero moves in smaller steps than at its largest value.
    """
    has_stepped = np.abs(np.diff(values)) > 0.5 * step
    last_move = np.maximum.accumulate(
        np.concatenate([[0], np.where(has_stepped, np.arange(1, len(values)), 0)])
    )
    steps = np.rint((values - values[last_move]) / step)
    return np.asarray(has_stepped | (np.diff(steps) != 0.0))


def _longest_constant(time_s: FloatArray, move_masks: BoolArray) -> tuple[float, float]:
    """Begin and length, s, of the longest segment without a move (n - 1,); length 0 for too few epochs."""
    changes = np.flatnonzero(move_masks)
    begins = np.concatenate([[0], changes + 1])
    ends = np.concatenate([changes, [len(move_masks)]])
    lengths_s = np.where(ends - begins >= _MIN_STUCK_EPOCHS, time_s[ends] - time_s[begins], 0.0)
    longest = int(np.argmax(lengths_s))
    return float(time_s[begins[longest]]), float(lengths_s[longest])
