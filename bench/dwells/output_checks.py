"""Output that is impossible at rest: values that stay constant, and values that jump.

At rest velocity and attitude move smoothly, by noise and by the error model alone. A corrupted frame, an
INS that restarted or a unit that was knocked shows as a jump from one epoch to the next; a
stuck output shows as a value that stays the same to the last bit for longer than the declared noise allows.
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

#: A value this many robust standard deviations and steps of the output away from its neighbours jumps.
_JUMP_SIGMAS, _JUMP_STEPS = 10.0, 4.0
_MAD_TO_SIGMA = 1.4826
#: Neither does one within this number of sigmas of white noise: pulses without dither are mostly still.
_WHITE_SIGMAS = 5.5
#: More jumps than this in a window are steps of the output.
_MANY_JUMPS = 30
#: Times, s, within which a slope may not change by this number of standard deviations, and how often
#: a window holds them.
_BEND_LAGS_S, _BEND_SIGMAS, _MIN_LAGS = (10.0, 30.0), 6.5, 3.0
#: What the error model may do to a channel is fitted down to this share of it.
_MIN_SHARE = 1e-6
#: A random walk stays within a step of the output longer than this multiple of the time in which it
#: goes that far once in ten thousand million times.
_STILL_TIMES = 6.0
#: Nothing counts as hanging before this number of epochs and this time, s.
_STILL_EPOCHS, _STILL_S = 30, 10.0
#: An INS is as noisy as declared if its attitude moves by this share of what that leads to expect, over
#: this time, s. A better one may well keep a velocity for minutes.
_NOISY_SHARE, _NOISY_OVER_S = 0.5, 10.0
#: It is noisier than declared if its mean square motion exceeds the expected one by this factor.
_NOISIER = 1.25
_VELOCITIES = ("velocity East", "velocity North")
_ATTITUDE = ("attitude about East", "attitude about North", "heading")
#: Rounding of the arithmetic: m/s and rad.
_ARITHMETIC = 1e-11


@dataclass(frozen=True)
class OutputFault:
    """What is wrong, in words, and whether noise larger than declared would explain it."""

    text: str
    may_be_noise: bool = False


def output_faults(
    windows: Sequence[NavigationWindow],
    noise: NoiseModel,
    gravity: float,
    velocity_step_mps: float,
    heading_step_rad: float,
) -> list[OutputFault]:
    """Say what is wrong with the output in the windows of a dwell.

    Parameters
    ----------
    windows : sequence of NavigationWindow
        With all their epochs.
    noise : NoiseModel
        Of the INS.
    gravity : float
        m/s^2.
    velocity_step_mps, heading_step_rad : float
        Resolution of the output.
    """
    steps = dict.fromkeys(_VELOCITIES, velocity_step_mps) | dict.fromkeys(_ATTITUDE, heading_step_rad)
    channels = [_channels(window) for window in windows]
    is_noisy = any(
        _is_noisy(window.time_s, each, noise.angle_random_walk)
        for window, each in zip(windows, channels, strict=True)
    )
    faults = []
    for number, (window, each) in enumerate(zip(windows, channels, strict=True), start=1):
        found = [
            _jump(window.time_s, each, steps, noise),
            _bend(window, steps, noise, gravity),
            _hanging(window.time_s, each, steps, noise) if is_noisy else None,
        ]
        faults += [replace(fault, text=f"window {number}: {fault.text}") for fault in found if fault]
    return faults


def _channels(window: NavigationWindow) -> dict[str, FloatArray]:
    rotation = rotation_vector_enu(window.C_nb, window.C_nb[0])
    velocities = dict(zip(_VELOCITIES, window.velocity_enu_mps.T, strict=False))
    return velocities | dict(zip(_ATTITUDE, rotation.T, strict=True))


def _jump(
    time_s: FloatArray, channels: Mapping[str, FloatArray], steps: Mapping[str, float], noise: NoiseModel
) -> OutputFault | None:
    """The first jump of any channel."""
    white = dict.fromkeys(_VELOCITIES, noise.velocity_white) | dict.fromkeys(_ATTITUDE, noise.heading_white)
    jumps = {
        name: _first_jump(time_s, values, steps[name], _WHITE_SIGMAS * white[name])
        for name, values in channels.items()
    }
    first = min(jumps, key=lambda name: jumps[name][0])
    time_of_first_s, count, size = jumps[first]
    if not math.isfinite(time_of_first_s):
        return None
    if count > _MANY_JUMPS:
        unit = "m/s" if first in _VELOCITIES else "rad"
        return OutputFault(
            f"the {first} moves in steps of about {size:.1g} {unit}, {count} of them: the resolution of the "
            "sensors limits the dwell, or frames are damaged. Dither the gyros; check the raw CAN log"
        )
    return OutputFault(
        f"the {first} jumps at {time_of_first_s:.1f} s on the clock of the INS: a damaged frame, an INS that "
        "restarted, or a unit that was knocked. Check the raw CAN log"
    )


def _bend(
    window: NavigationWindow, steps: Mapping[str, float], noise: NoiseModel, gravity: float
) -> OutputFault | None:
    """A slope that changes by more than error model and noise let it."""
    for lag_s in _BEND_LAGS_S:
        for name, (middle_s, bends, sigma) in _bends(window, steps, noise, gravity, lag_s).items():
            away = np.abs(bends)
            if away.max() > _BEND_SIGMAS * sigma:
                own_sigma = _MAD_TO_SIGMA * float(np.median(away))
                may_be_noise = bool(away.max() <= _BEND_SIGMAS * own_sigma)
                return OutputFault(
                    f"the {name} bends within {lag_s:g} s of {middle_s[np.argmax(away)]:.1f} s on the clock "
                    "of the INS by more than its noise explains: was the unit moved?",
                    may_be_noise,
                )
    return None


def _bends(
    window: NavigationWindow, steps: Mapping[str, float], noise: NoiseModel, gravity: float, lag_s: float
) -> dict[str, tuple[FloatArray, FloatArray, float]]:
    """Change of the slope of what the error model leaves of each channel; empty for short windows.

    For each: times (n,), the change within a lag around them (n,), and its standard deviation.
    """
    thinned = window.thinned(EPOCH_S)
    time_s = thinned.time_s
    if time_s[-1] - time_s[0] < _MIN_LAGS * lag_s:
        return {}
    channels = _channels(thinned)
    explained = _error_model(time_s - time_s[0], gravity)
    values = np.array([*channels.values()]).T
    # An offset as large as the Earth's rotation must not limit how exactly the rest is taken away.
    values = values - values.mean(axis=0)
    values = values - explained @ np.linalg.lstsq(explained, values, rcond=_MIN_SHARE)[0]
    middle_s = time_s[(time_s >= time_s[0] + lag_s) & (time_s <= time_s[-1] - lag_s)]
    result = {}
    for name, rest in zip(channels, values.T, strict=True):
        before, at, after = (np.interp(middle_s + away_s, time_s, rest) for away_s in (-lag_s, 0.0, lag_s))
        if name in _VELOCITIES:
            walk, white = noise.velocity_random_walk, noise.velocity_white
            tilted = (gravity * noise.angle_random_walk) ** 2 * lag_s**3 * 2.0 / 3.0
        else:
            walk, white, tilted = noise.angle_random_walk, noise.heading_white, 0.0
        white = max(white, steps[name] / math.sqrt(12.0))
        sigma = math.sqrt(2.0 * walk**2 * lag_s + 6.0 * white**2 + tilted)
        result[name] = middle_s, before - 2.0 * at + after, sigma
    return result


def _error_model(time_s: FloatArray, gravity: float) -> FloatArray:
    """All that the error model lets a channel do at rest, (n, 9): Schuler loop, rotation of the Earth."""
    schuler = math.sqrt(gravity / MEAN_RADIUS) * time_s
    swing = np.array([np.sin(schuler), np.cos(schuler)])
    # The Earth's rotation splits the Schuler frequency a little.
    earth = [np.sin(EARTH_RATE * time_s), np.cos(EARTH_RATE * time_s)]
    share = time_s / time_s[-1]
    return np.array([np.ones(len(time_s)), share, share**2, *swing, *(share * swing), *earth]).T


def exceeds_noise(
    windows: Sequence[NavigationWindow],
    noise: NoiseModel,
    gravity: float,
    velocity_step_mps: float,
    heading_step_rad: float,
) -> bool:
    """Whether velocities or attitude move more than this noise explains; see :func:`output_faults`."""
    steps = dict.fromkeys(_VELOCITIES, velocity_step_mps) | dict.fromkeys(_ATTITUDE, heading_step_rad)
    bends = [_bends(window, steps, noise, gravity, _NOISY_OVER_S) for window in windows]
    for names in (_VELOCITIES, _ATTITUDE):
        squares = [
            float(np.mean((each[name][1] / each[name][2]) ** 2)) for each in bends for name in names if each
        ]
        if squares and float(np.mean(squares)) > _NOISIER:
            return True
    return False


def rounding(
    rests: Sequence[RestOutput], velocity_step_mps: float, heading_step_rad: float
) -> tuple[float, float]:
    """Standard uncertainties, m/s and rad, of velocity and heading by rounding, at an epoch a second."""
    velocities, headings = [], []
    for rest in rests:
        if len(rest.time_s) > 1:
            every = max(1, round(EPOCH_S / float(np.median(np.diff(rest.time_s)))))
            velocities += [*rest.velocity_enu_mps[::every, :2].T]
            headings.append(rotation_vector_enu(rest.C_nb[::every], rest.C_nb[0])[:, 2])
    found = []
    for channels, step in ((velocities, velocity_step_mps), (headings, heading_step_rad)):
        changes = sum(1 + np.count_nonzero(np.abs(np.diff(each)) > _ARITHMETIC) for each in channels)
        found.append(rounding_sigma(step, sum(map(len, channels)) / max(changes, 1)))
    return found[0], found[1]


def _hanging(
    time_s: FloatArray, channels: Mapping[str, FloatArray], steps: Mapping[str, float], noise: NoiseModel
) -> OutputFault | None:
    """What stays the same for longer than noise lets it."""
    pulse = math.sqrt(12.0) * noise.heading_white
    steps = {name: max(step, pulse) if name in _ATTITUDE else step for name, step in steps.items()}
    moves = {name: _moves(values, max(steps[name], _ARITHMETIC)) for name, values in channels.items()}
    walks = {"heading": noise.angle_random_walk} | dict.fromkeys(_VELOCITIES, noise.velocity_random_walk)
    longest_s = {
        name: max(_STILL_S, _STILL_TIMES * (max(steps[name], _ARITHMETIC) / walk) ** 2) if walk else math.inf
        for name, walk in walks.items()
    }
    # All channels stay as long as the one does that walks through its steps the fastest.
    moves["whole output"] = np.any(list(moves.values()), axis=0)
    longest_s["whole output"] = min(longest_s.values())
    for name, limit_s in longest_s.items():
        begin_s, still_s = _longest_still(time_s, moves[name])
        if still_s > limit_s:
            return OutputFault(
                f"the {name} stays the same for {still_s:.0f} s from {begin_s:.1f} s on the clock of the "
                "INS, longer than its noise allows: the output is stuck. Restart the INS"
            )
    return None


def _is_noisy(time_s: FloatArray, channels: Mapping[str, FloatArray], walk: float) -> bool:
    """Whether any angle moves about as much as its declared random walk."""
    lag = max(1, round(_NOISY_OVER_S / float(np.median(np.diff(time_s)))))
    expected = walk * math.sqrt(2.0 * _NOISY_OVER_S)
    angles = [channels[name] for name in _ATTITUDE]
    bends = [each[2 * lag :] - 2.0 * each[lag:-lag] + each[: -2 * lag] for each in angles]
    return any(len(each) > 0 and float(np.std(each)) > _NOISY_SHARE * expected for each in bends)


def _first_jump(
    time_s: FloatArray, values: FloatArray, step: float, white: float
) -> tuple[float, int, float]:
    """Time of the first value that its neighbours, and white noise, do not lead to expect; or infinite.

    And how many there are, and how far off the typical one of them is.
    """
    before_s, after_s = time_s[1:-1] - time_s[:-2], time_s[2:] - time_s[1:-1]
    expected = (values[:-2] * after_s + values[2:] * before_s) / (before_s + after_s)
    away = values[1:-1] - expected
    # Across lost epochs a random walk goes as far as the root of the time.
    wide = np.sqrt((before_s + after_s) / (2.0 * np.median(after_s)))
    sigma = _MAD_TO_SIGMA * float(np.median(np.abs(away)))
    jumps = np.abs(away) > (max(_JUMP_SIGMAS * sigma, white) + _JUMP_STEPS * step) * np.maximum(wide, 1.0)
    if not jumps.any():
        return math.inf, 0, 0.0
    return float(time_s[1:-1][jumps][0]), int(jumps.sum()), float(np.median(np.abs(away[jumps])))


def _moves(values: FloatArray, step: float) -> BoolArray:
    """Whether each value but the first is half a step off the one before, or off where it stayed so far.

    A floating-point number near zero moves in smaller steps than at its largest value.
    """
    moved = np.abs(np.diff(values)) > 0.5 * step
    since = np.maximum.accumulate(np.concatenate([[0], np.where(moved, np.arange(1, len(values)), 0)]))
    away = np.rint((values - values[since]) / step)
    return np.asarray(moved | (np.diff(away) != 0.0))


def _longest_still(time_s: FloatArray, moves: BoolArray) -> tuple[float, float]:
    """Begin and length of the longest segment without a move (n - 1,), if it has enough epochs."""
    changes = np.flatnonzero(moves)
    first = np.concatenate([[0], changes + 1])
    last = np.concatenate([changes, [len(moves)]])
    lengths_s = np.where(last - first >= _STILL_EPOCHS, time_s[last] - time_s[first], 0.0)
    longest = int(np.argmax(lengths_s))
    return float(time_s[first[longest]]), float(lengths_s[longest])
