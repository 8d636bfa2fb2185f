"""A quantity that was measured at some temperatures, read at others."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from gyrobench.bench.bias.weighted_mean import weighted_mean
from gyrobench.bench.foundations.arrays import FloatArray

#: How far beyond the outermost temperature that was measured a curve goes, K.
REACH_K = 2.0
#: Values within this are averaged, K.
AVERAGED_K = 5.0

# Values that scatter so improbably about their mean make it less certain.
_CHANCE = 0.01


class TemperatureCurve:
    """Values at some temperatures, and straight lines between them.

    Values at nearly the same temperature are averaged. A line across a gap is wrong by what the
    curve bends there; taken for that is the next term of Newton's interpolation, from the bend that
    the neighbouring temperatures show beyond its own noise. Where there are two temperatures in
    all, the change from one to the other is taken for a parabola that is level at one end.

    Parameters
    ----------
    points : iterable of tuple
        Temperature in degrees Celsius, value, standard uncertainty; NaN among them is passed over.
    slope_sigma : float
        Standard uncertainty of a slope that nothing is known of, per K.
    """

    def __init__(self, points: Iterable[tuple[float, float, float]], slope_sigma: float) -> None:
        self._slope_sigma = slope_sigma
        measured = sorted(point for point in points if not any(map(math.isnan, point)))
        nodes = [_averaged(group) for group in _grouped(measured)]
        self._temperature_c, self._value, self._sigma = np.array(nodes).reshape(-1, 3).T
        self._ends_c = (measured[0][0], measured[-1][0]) if measured else (math.inf, -math.inf)

    def at(self, temperature_c: float) -> tuple[float, float] | None:
        """Value and standard uncertainty; None where nothing was measured near or on both sides."""
        first_c, last_c = self._ends_c
        if not first_c - REACH_K <= temperature_c <= last_c + REACH_K:
            return None
        nodes = self._temperature_c
        if nodes[0] < temperature_c < nodes[-1]:
            return self._between(temperature_c)
        end = 0 if temperature_c <= nodes[0] else -1
        away = self._slope_sigma * abs(temperature_c - nodes[end])
        return float(self._value[end]), math.hypot(self._sigma[end], away)

    def _between(self, temperature_c: float) -> tuple[float, float]:
        nodes = self._temperature_c
        low = int(np.searchsorted(nodes, temperature_c, side="right")) - 1
        above_c, below_c = temperature_c - nodes[low], nodes[low + 1] - temperature_c
        shares = np.array([below_c, above_c]) / (above_c + below_c)
        pair = slice(low, low + 2)
        noise = np.linalg.norm(shares * self._sigma[pair])
        return float(shares @ self._value[pair]), math.hypot(noise, self._bend(low) * above_c * below_c)

    def _bend(self, low: int) -> float:
        """Second divided difference at the gap above a node: the largest of those that touch it."""
        nodes = self._temperature_c
        if len(nodes) == 2:
            weights = np.array([-1.0, 1.0]) / (nodes[1] - nodes[0]) ** 2
            return self._beyond_noise(slice(0, 2), weights)
        firsts = range(max(low - 1, 0), min(low + 1, len(nodes) - 2))
        triples = [slice(first, first + 3) for first in firsts]
        return max(self._beyond_noise(triple, _divided_difference(nodes[triple])) for triple in triples)

    def _beyond_noise(self, nodes: slice, weights: FloatArray) -> float:
        """Size of a weighted sum of values, less what their noise adds to it."""
        total, noise = weights @ self._value[nodes], np.linalg.norm(weights * self._sigma[nodes])
        return math.sqrt(max(float(total**2 - noise**2), 0.0))


def _divided_difference(nodes: FloatArray) -> FloatArray:
    """Weights of three values in their second divided difference."""
    apart = nodes[:, np.newaxis] - nodes + np.eye(3)
    return np.asarray(1.0 / apart.prod(axis=1))


def _grouped(points: Iterable[tuple[float, float, float]]) -> list[list[tuple[float, float, float]]]:
    """Cut points in the order of temperature into groups of one temperature each."""
    groups: list[list[tuple[float, float, float]]] = []
    for point in points:
        if groups and point[0] - groups[-1][0][0] <= AVERAGED_K:
            groups[-1].append(point)
        else:
            groups.append([point])
    return groups


def _averaged(group: list[tuple[float, float, float]]) -> tuple[float, float, float]:
    temperatures, values, sigmas = zip(*group, strict=True)
    mean = weighted_mean(values, sigmas)
    scatter = math.sqrt(mean.chi2_reduced) if mean.p_value < _CHANCE else 1.0
    return weighted_mean(temperatures, sigmas).value, mean.value, mean.sigma * scatter
