"""What a search found, in sentences for a person."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.closure.closure import Closure, FoundEffect
from gyrobench.bench.foundations.text import listed, plain_name

_S_PER_H = 3600.0
_UNITS = {"c": "degC"}


def statement(found: FoundEffect) -> str:
    """One sentence: what the bias does, on which gyros, how much, with which parameters."""
    parameters = ", ".join(
        _parameter(each.name, value)
        for each, value in zip(found.candidate.form.parameters, found.candidate.values, strict=True)
    )
    gyros = f"{listed(found.axes)} gyro{'s' if len(found.axes) > 1 else ''}"
    size = f"{found.rms_dph:.2g} deg/h rms on the {gyros}"
    sentence = found.candidate.effect.statement
    return f"{sentence[0].upper()}{sentence[1:]}: {size}{f' ({parameters})' if parameters else ''}."


def _parameter(name: str, value: float) -> str:
    """Name and value of a parameter with its unit: "tau 1.5 h", "onset width 4.2 degC"."""
    words, _, unit = name.replace("_", " ").rpartition(" ")
    if unit == "s" and abs(value) >= _S_PER_H:
        return f"{words} {value / _S_PER_H:.2f} h"
    return f"{words} {value:.3g} {_UNITS.get(unit, unit)}"


def separating_measurement(closure: Closure) -> str | None:
    """What to measure next to split the first tie; None without ties."""
    experiments = {each.effect.name: each.effect.experiment for each in closure.evidence}
    for found in closure.effects:
        if found.tied_with:
            other = found.tied_with[0]
            one = found.candidate.effect
            return (
                f"To tell {plain_name(one.name)} from {plain_name(other)}: {one.experiment}; "
                f"for {plain_name(other)}: {experiments[other]}."
            )
    return None


def whereabouts(closure: Closure) -> str | None:
    """Where the model leaves most, if anything is left: size, position, temperatures, times."""
    if closure.verdict != "unexplained":
        return None
    campaign, searched = closure.campaign, closure.searched
    rest = (campaign.bias_dph - closure.model.bias_dph)[searched]
    size = np.sqrt(np.mean(rest**2))
    squares = np.sum(rest**2, axis=1)
    names = np.array(campaign.position)[searched]
    position = max(sorted(set(names)), key=lambda name: float(squares[names == name].mean()))
    low_c, high_c = _worst_span(campaign.gyro_c[searched].mean(axis=1), squares)
    low_h, high_h = _worst_span(campaign.middle_s[searched] / 3600.0, squares)
    return (
        f"{size:.2g} deg/h rms is left, {closure.after.noise_ratio:.1f} times the noise; it follows "
        f"{closure.after.follows} most clearly, and is largest in position {plain_name(position)}, "
        f"at {low_c:.0f} to {high_c:.0f} degC, and at {low_h:.0f} to {high_h:.0f} h."
    )


def _worst_span(
    values: np.ndarray[tuple[int], np.dtype[np.float64]],
    squares: np.ndarray[tuple[int], np.dtype[np.float64]],
) -> tuple[float, float]:
    """Eighth of the range of values with the largest mean square."""
    edges = np.linspace(values.min(), values.max(), 9)
    place = np.clip(np.digitize(values, edges) - 1, 0, 7)
    means = [float(squares[place == each].mean()) if np.any(place == each) else -1.0 for each in range(8)]
    worst = int(np.argmax(means))
    return float(edges[worst]), float(edges[worst + 1])
