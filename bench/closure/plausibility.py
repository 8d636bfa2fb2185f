"""Plausibility of a dwell table: what a search would take for data although no bench measures it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.contradictions import contradictions
from gyrobench.bench.closure.quantity import GYRO_BIAS, Quantity
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.text import agreeing, counted

#: Temperatures at which no INS is calibrated, degC.
_COLDEST_C, _HOTTEST_C = -150.0, 200.0
#: From this on, a temperature that is too high is probably in kelvin.
_KELVIN_FROM = 213.15
#: Sigmas this many times the spread of all biases of a gyro are wrong. With right ones that has a
#: probability below 1e-7 in the least number of dwells.
_MAX_SIGMA_TO_SPREAD, _MIN_DWELLS = 10.0, 8
#: No gyro has a smaller angle random walk, deg/sqrt(h): the best ones have 1e-5. A unit that columns may be
#: in, by the factor that brings them to deg/h, fits if it gives a random walk that gyros have.
_MIN_RANDOM_WALK, _USUAL_RANDOM_WALK = 3e-6, (3e-5, 3e-2)
_RATE_UNITS = {"deg/s": 3600.0, "rad/s": math.degrees(3600.0)}
#: Spread of the biases, in sigmas, from which a wrong unit is that of the sigmas alone.
_MAX_SPREAD_TO_SIGMA = 1e3
#: Copies that are no chance of rounded values: their number, and their share of the dwells.
_MIN_COPIES, _MIN_COPIED = 3, 0.05
_TEMPERATURES = {
    "gyro_{}_c": "gyro_c",
    "board_{}_c": "board_c",
    "case_c": "case_c",
    "chamber_c": "chamber_c",
    "chamber_set_c": "chamber_set_c",
}


def implausible(rows: Sequence[DwellRow], quantity: Quantity = GYRO_BIAS) -> list[str]:
    """Everything about the dwells without flags that can't be measured data, each as one sentence."""
    good = [row for row in rows if not row.flags]
    if not good:
        return []
    problems = [*_times(good), *_copies(good), *_temperatures(good), *_sigmas(good, quantity)]
    if not problems and quantity.is_gyro_bias:
        problems += _too_small(good)
    return problems or contradictions(good)


def _times(rows: Sequence[DwellRow]) -> Iterator[str]:
    starts = Counter(row.start_s for row in rows)
    most_s, count = starts.most_common(1)[0]
    if count > 1:
        yield (
            f"{count} of {len(rows)} dwells start at {most_s:g} s: start_s has to be on one clock for the "
            "whole table"
        )
        return
    for run in dict.fromkeys(row.run for row in rows):
        ordered = sorted((row for row in rows if row.run == run), key=lambda row: row.start_s)
        for row, after in pairwise(ordered):
            if after.start_s < row.end_s - 1e-3:
                yield (
                    f"dwell {after.dwell} starts at {after.start_s:g} s, before dwell {row.dwell} ends at "
                    f"{row.end_s:g} s"
                )
                return


def _copies(rows: Sequence[DwellRow]) -> Iterator[str]:
    """Dwells that are pasted twice: a held-out copy follows the model, noise and all."""
    first: dict[tuple[float, ...], DwellRow] = {}
    copies = []
    for row in rows:
        values = (*row.bias_dph, *row.gyro_c)
        if all(map(math.isfinite, values)) and first.setdefault(values, row) is not row:
            copies.append((row, first[values]))
    if len(copies) >= max(_MIN_COPIES, _MIN_COPIED * len(rows)):
        row, other = copies[0]
        others = len(copies) - 1
        yield (
            f"dwell {row.dwell} has biases and gyro temperatures of dwell {other.dwell} to the last digit,"
            f" and {counted(others, 'other')} {agreeing(others, 'has', 'have')} those of another one: leave "
            "the copies out"
        )


def _temperatures(rows: Sequence[DwellRow]) -> Iterator[str]:
    for pattern, name in _TEMPERATURES.items():
        values = np.array([getattr(row, name) for row in rows], dtype=np.float64).reshape(len(rows), -1)
        for axis, column in zip("xyz", values.T, strict=False):
            problem = _temperature(column, [row.dwell for row in rows])
            if problem:
                yield f"{pattern.format(axis)} {problem}"


def _temperature(column: FloatArray, dwells: Sequence[int]) -> str:
    """What is wrong with the temperatures of these dwells, degC; empty where nothing is."""
    wrong = np.flatnonzero((column < _COLDEST_C) | (column > _HOTTEST_C))
    if not len(wrong):
        return ""
    index = wrong[np.argmax(np.abs(column[wrong]))]
    worst, others = column[index], f" and {counted(len(wrong) - 1, 'other')}" if len(wrong) > 1 else ""
    kelvin = bool(np.nanmin(column) > _KELVIN_FROM) and worst < _HOTTEST_C + 273.15
    advice = "the column seems to be in kelvin" if kelvin else "correct the value or its unit"
    where = f"in dwell {dwells[index]}{others}"
    return f"is {worst:g} degC {where}, outside {_COLDEST_C:g} to {_HOTTEST_C:g} degC: {advice}"


def _sigmas(rows: Sequence[DwellRow], quantity: Quantity) -> Iterator[str]:
    # The uncertainty of an accelerometer's bias in a dwell includes what is common to all dwells.
    if len(rows) < _MIN_DWELLS or quantity.name == "accelerometer_bias":
        return
    biases, sigmas = (
        np.array([getattr(row, name) for row in rows], dtype=np.float64) for name in ("bias_dph", "sigma_dph")
    )
    for name, axis, bias, sigma in zip(quantity.coefficients, "xyz", biases.T, sigmas.T, strict=True):
        if not np.isfinite(sigma).any():
            continue
        spread, stated = float(np.nanstd(bias)), float(np.nanmedian(sigma))
        column, values = f"the uncertainty of {name}", "values"
        if quantity.is_gyro_bias:
            column, values = f"sigma_{axis}_dph", "biases of that gyro"
        if stated > _MAX_SIGMA_TO_SPREAD * spread:
            yield (
                f"{column} is {stated:.2g} {quantity.unit}, although all {values} lie within "
                f"{spread:.2g} {quantity.unit} rms: correct its values or their unit"
            )


def _too_small(rows: Sequence[DwellRow]) -> Iterator[str]:
    """Uncertainties below what the least noise of a gyro gives over the length of the dwells."""
    biases, sigmas = (
        np.array([getattr(row, name) for row in rows], dtype=np.float64) for name in ("bias_dph", "sigma_dph")
    )
    hours = np.array([row.end_s - row.start_s for row in rows])[:, np.newaxis] / 3600.0
    known = [gyro for gyro in range(3) if np.isfinite(sigmas[:, gyro]).any()]
    walks = {gyro: float(np.nanmedian(sigmas[:, [gyro]] * np.sqrt(hours))) for gyro in known}
    wrong = [gyro for gyro, walk in walks.items() if walk < _MIN_RANDOM_WALK]
    if not wrong:
        return
    gyros = ",".join("xyz"[gyro] for gyro in wrong)
    gyros = f"{{{gyros}}}" if len(wrong) > 1 else gyros
    walk = max(walks[gyro] for gyro in wrong)
    low, high = _USUAL_RANDOM_WALK
    units = {unit: factor for unit, factor in _RATE_UNITS.items() if low <= walk * factor <= high}
    spread = np.nanstd(biases[:, wrong], axis=0) / np.nanmedian(sigmas[:, wrong], axis=0)
    columns = f"sigma_{gyros}_dph"
    if spread.max() < _MAX_SPREAD_TO_SIGMA:
        columns = f"bias_{gyros}_dph and {columns}"
    advice = f"correct {columns} or their unit"
    if units:
        factors = " or ".join(f"{factor:.6g}" for factor in units.values())
        advice = f"the unit seems to be {' or '.join(units)}: multiply {columns} by {factors}"
    yield (
        f"sigma_{gyros}_dph in dwells of this length mean an angle random walk of {walk:.1g} deg/sqrt(h), "
        f"less than the {_MIN_RANDOM_WALK:g} deg/sqrt(h) of any gyro: {advice}"
    )
