"""Plausibility of a dwell table: detects values that no bench can have measured.

Columns are tested by themselves, then against each other: a wrong unit or sign makes a search find a wrong
cause with certainty. Within a power cycle, start_s minus since_power_on_s is constant. Between neighbouring
dwells on a ramp, a temperature changes by its mean rate times the time between their middles; while it
settles after a ramp, by the logarithmic mean of both rates times that time. Each relation gives a factor, and
both factors together identify the wrong column.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby, pairwise

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.quantity import GYRO_BIAS, Quantity
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.foundations.text import counted, plural
from gyrobench.bench.navigation.positions import AXES

#: Temperatures at which no INS is calibrated, degC.
_COLDEST_C, _HOTTEST_C = -150.0, 200.0
#: Columns whose values are all above this, and some too high, are probably in kelvin.
_KELVIN_FROM = 213.15
#: No gyro that navigates has a larger bias, deg/h.
_MAX_BIAS_DPH = 1e6
#: Sigmas above this multiple of the spread of a gyro's biases are wrong. For correct sigmas this has a
#: probability below 1e-7 with the smallest number of dwells tested.
_MAX_SIGMA_TO_SPREAD, _MIN_DWELLS = 10.0, 8
#: No gyro has a smaller angle random walk, deg/sqrt(h): the best ones have 1e-5. Another unit, with its
#: factor to deg/h, is suggested if it gives a usual random walk.
_MIN_RANDOM_WALK, _USUAL_RANDOM_WALK = 3e-6, (3e-5, 3e-2)
_RATE_UNITS = {"deg/s": 3600.0, "rad/s": math.degrees(3600.0)}
#: If the spread of the biases is at least this many sigmas, only the unit of the sigmas is wrong.
_MAX_SPREAD_TO_SIGMA = 1e3
#: Equal dwells are copies, not chance, from this number and this share of the dwells on.
_MIN_COPIES, _MIN_COPIED = 3, 0.05
#: Rows are in two units if their sizes form two groups of at least this share of the rows, with a ratio of
#: the medians of about 1000, and decadic logarithms that scatter by less than this in each.
_MIN_GROUP, _THOUSAND, _MAX_SCATTER = 0.1, (300.0, 3000.0), 0.5
_OTHER_UNITS = {"deg/h": "mdeg/h", "ug": "mg"}
_TEMPERATURES = {
    "gyro_{}_c": "gyro_c",
    "board_{}_c": "board_c",
    "case_c": "case_c",
    "chamber_c": "chamber_c",
    "chamber_set_c": "chamber_set_c",
}


def implausible(rows: Sequence[DwellRow], quantity: Quantity = GYRO_BIAS) -> list[str]:
    """Sentences on everything in the dwells without flags that can't be measured data."""
    unflagged = [row for row in rows if not row.flags]
    if not unflagged:
        return []
    problems = [
        *_times(unflagged),
        *_copies(unflagged),
        *_mixed_units(unflagged, quantity),
        *_temperatures(unflagged),
        *_sigmas_not_positive(unflagged, quantity),
        *_large_sigmas(unflagged, quantity),
        *(_large_biases(unflagged) if quantity.is_gyro_bias else ()),
    ]
    if not problems and quantity.is_gyro_bias:
        problems += _small_sigmas(unflagged)
    return problems or _contradictions(unflagged)


def _times(rows: Sequence[DwellRow]) -> Iterator[str]:
    starts = Counter(row.start_s for row in rows)
    start_s, count = starts.most_common(1)[0]
    if count > 1:
        yield (
            f"{count} of {len(rows)} dwells start at {start_s:g} s: start_s has to be on one clock for the "
            "whole table"
        )
        return
    for run in dict.fromkeys(row.run for row in rows):
        ordered = sorted((row for row in rows if row.run == run), key=lambda row: row.start_s)
        for row, later in pairwise(ordered):
            if later.start_s < row.end_s - 1e-3:
                yield (
                    f"dwell {later.dwell} starts at {later.start_s:g} s, before dwell {row.dwell} ends at "
                    f"{row.end_s:g} s"
                )
                return


def _copies(rows: Sequence[DwellRow]) -> Iterator[str]:
    """Dwells that were pasted twice: the model would predict a held-out copy including its noise."""
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
            f" and {counted(others, 'other')} {plural(others, 'has', 'have')} those of another one: leave "
            "the copies out"
        )


def _mixed_units(rows: Sequence[DwellRow], quantity: Quantity) -> Iterator[str]:
    """Values, perhaps with their uncertainties, a thousand times as large in some rows as in the others."""
    is_large, has_large_sigma = (
        _thousand_times_larger(np.abs(_values(rows, name))) for name in ("bias_dph", "sigma_dph")
    )
    if is_large.any():
        columns = f"{quantity.label} values{' and uncertainties' if has_large_sigma.any() else ''}"
        first, count = rows[int(np.argmax(is_large))].dwell, int(is_large.sum())
        other = _OTHER_UNITS.get(quantity.unit, "another unit")
        yield (
            f"{columns} of {counted(count, quantity.row)}, the first is {first}, are about 1000 times as "
            f"large as those of the other {len(rows) - count}: some seem to be in {other}; give all in "
            f"{quantity.unit}"
        )


def _thousand_times_larger(sizes: FloatArray) -> BoolArray:
    """Whether each row of sizes (n, 3) is in a separate group of larger ones; all false without one.

    The median of a row counts, so that one failed gyro makes no group.
    """
    counts = np.isfinite(sizes).sum(axis=1)
    ordered = np.sort(np.where(np.isfinite(sizes), sizes, np.inf), axis=1)
    middle = np.stack([np.maximum(counts - 1, 0), counts], axis=1) // 2
    row_sizes = np.where(counts > 0, np.take_along_axis(ordered, middle, axis=1).mean(axis=1), 0.0)
    is_used = row_sizes > 0.0
    logs, count = np.sort(np.log10(row_sizes[is_used])), int(is_used.sum())
    smallest = max(_MIN_COPIES, math.ceil(_MIN_GROUP * count))
    splits = np.arange(smallest, count - smallest + 1)
    if not len(splits):
        return np.zeros_like(is_used)
    # That with the largest sum of squares between the groups has the smallest within them.
    sums = np.cumsum(logs - logs.mean())[splits - 1]
    split = int(splits[np.argmax(sums**2 / (splits * (count - splits)))])
    ratio = 10.0 ** float(np.median(logs[split:]) - np.median(logs[:split]))
    scatter = max(np.std(logs[:split]), np.std(logs[split:]))
    is_separate = _THOUSAND[0] < ratio < _THOUSAND[1] and scatter < _MAX_SCATTER
    return np.asarray(is_used & (row_sizes >= 10.0 ** logs[split] * (1.0 - 1e-9)) & is_separate)


def _temperatures(rows: Sequence[DwellRow]) -> Iterator[str]:
    for pattern, name in _TEMPERATURES.items():
        values = _values(rows, name).reshape(len(rows), -1)
        for axis, column in zip("xyz", values.T, strict=False):
            problem = _temperature_problem(column, [row.dwell for row in rows])
            if problem:
                yield f"{pattern.format(axis)} {problem}"


def _temperature_problem(column: FloatArray, dwells: Sequence[int]) -> str:
    """Problem of a column of temperatures, degC; empty if there is none."""
    wrong = np.flatnonzero((column < _COLDEST_C) | (column > _HOTTEST_C))
    if not len(wrong):
        return ""
    index = wrong[np.argmax(np.abs(column[wrong]))]
    worst, others = column[index], f" and {counted(len(wrong) - 1, 'other')}" if len(wrong) > 1 else ""
    is_kelvin = bool(np.nanmin(column) > _KELVIN_FROM) and worst < _HOTTEST_C + 273.15
    advice = "the column seems to be in kelvin" if is_kelvin else "correct the value or its unit"
    where = f"in dwell {dwells[index]}{others}"
    return f"is {worst:g} degC {where}, outside {_COLDEST_C:g} to {_HOTTEST_C:g} degC: {advice}"


def _large_biases(rows: Sequence[DwellRow]) -> Iterator[str]:
    """Biases that no gyro has, as of a number that lost its decimal point."""
    for axis, column in zip(AXES, np.abs(_values(rows, "bias_dph")).T, strict=True):
        wrong = np.flatnonzero(column > _MAX_BIAS_DPH)
        if len(wrong):
            others = f" and {counted(len(wrong) - 1, 'other')}" if len(wrong) > 1 else ""
            yield (
                f"bias_{axis}_dph is {column[wrong[0]]:.3g} deg/h in size in dwell "
                f"{rows[wrong[0]].dwell}{others}, more than the {_MAX_BIAS_DPH:g} deg/h of any gyro: "
                "correct the value or its unit"
            )


def _sigmas_not_positive(rows: Sequence[DwellRow], quantity: Quantity) -> Iterator[str]:
    for column, sigma in zip(_sigma_columns(quantity), _values(rows, "sigma_dph").T, strict=True):
        wrong = np.flatnonzero(sigma <= 0.0)
        if len(wrong):
            others = f" and {counted(len(wrong) - 1, 'other')}" if len(wrong) > 1 else ""
            yield (
                f"{column} is {sigma[wrong[0]]:g} {quantity.unit} in {quantity.row} {rows[wrong[0]].dwell}"
                f"{others}; it must be above zero: correct the value, or leave it empty"
            )


def _sigma_columns(quantity: Quantity) -> list[str]:
    """Names of the columns of uncertainties, in sentences."""
    if quantity.is_gyro_bias:
        return [f"sigma_{axis}_dph" for axis in AXES]
    return [f"the uncertainty of {name}" for name in quantity.coefficients]


def _large_sigmas(rows: Sequence[DwellRow], quantity: Quantity) -> Iterator[str]:
    # The uncertainty of an accelerometer's bias in a dwell includes errors common to all dwells.
    if len(rows) < _MIN_DWELLS or quantity.name == "accelerometer_bias":
        return
    biases, sigmas = _values(rows, "bias_dph"), _values(rows, "sigma_dph")
    values = "biases of that gyro" if quantity.is_gyro_bias else "values"
    for column, bias, sigma in zip(_sigma_columns(quantity), biases.T, sigmas.T, strict=True):
        if not np.isfinite(sigma).any():
            continue
        spread, stated = float(np.nanstd(bias)), float(np.nanmedian(sigma))
        if stated > _MAX_SIGMA_TO_SPREAD * spread:
            yield (
                f"{column} is {stated:.2g} {quantity.unit}, although all {values} lie within "
                f"{spread:.2g} {quantity.unit} rms: correct its values or their unit"
            )


def _small_sigmas(rows: Sequence[DwellRow]) -> Iterator[str]:
    """Uncertainties below those that the smallest gyro noise gives over the length of the dwells."""
    biases, sigmas = _values(rows, "bias_dph"), _values(rows, "sigma_dph")
    hours = np.array([row.end_s - row.start_s for row in rows])[:, np.newaxis] / 3600.0
    gyros_with_sigma = [gyro for gyro in range(3) if np.isfinite(sigmas[:, gyro]).any()]
    random_walks = {
        gyro: float(np.nanmedian(sigmas[:, [gyro]] * np.sqrt(hours))) for gyro in gyros_with_sigma
    }
    wrong_gyros = [gyro for gyro, walk in random_walks.items() if walk < _MIN_RANDOM_WALK]
    if not wrong_gyros:
        return
    gyros = _axes(["xyz"[gyro] for gyro in wrong_gyros])
    walk = max(random_walks[gyro] for gyro in wrong_gyros)
    low, high = _USUAL_RANDOM_WALK
    units = {unit: factor for unit, factor in _RATE_UNITS.items() if low <= walk * factor <= high}
    spread = np.nanstd(biases[:, wrong_gyros], axis=0) / np.nanmedian(sigmas[:, wrong_gyros], axis=0)
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


#: Units that a column may be in, by the factor that converts it to s, or to degC/h.
_TIMES = {1e-3: "ms", 60.0: "min", 3600.0: "h"}
_DEGF_PER_DEGC = 1.8
_RATES = {60.0: "degC/min", 3600.0: "degC/s", 1.0 / _DEGF_PER_DEGC: "degF/h"}
#: Largest relative deviation of a factor from that of a unit, and between equal factors.
_SAME_FACTOR = 0.2
#: Smallest number of pairs of dwells that determine a factor; smallest change of temperature used, degC.
_MIN_PAIRS, _MIN_CHANGE_C = 3, 1.0
#: On a ramp, the rates of two dwells differ by at most this share, and the time between the dwells is at most
#: this many times their length. The temperature then changes by 0.8 to 1.3 times what correct rates give.
_MAX_RATE_CHANGE, _MAX_GAP = 0.5, 1.0
_MIN_FACTOR, _MAX_FACTOR = 0.6, 1.0 / 0.6
#: The same while a temperature settles.
_MIN_SETTLING_PAIRS, _MIN_SETTLED_C = 4, 0.2
#: A wrong unit gives at least this share of the pairs the same factor, within this tolerance. Noise and other
#: courses of the temperature scatter; several time constants give a common factor below this limit.
_MIN_SAME, _SAME_SETTLING, _MAX_SETTLING_FACTOR = 0.8, 0.35, 5.0
#: Equal power-on times differ by at most this, plus this share of the time since the first dwell.
_POWER_ON_S, _CLOCK_DRIFT = 60.0, 1e-3
#: Limits of the length of a dwell with a turn, s; the upper one is only probable.
_MIN_DWELL_S, _MAX_DWELL_S = 2.0, 1e5
#: Smallest range of the chamber's or case's temperatures, degC, with which that of a gyro shows its unit,
#: since self-heating adds less than the difference. In degF the gyro's range is 1.8 times as large, within
#: this share.
_MIN_PROFILE_C, _SAME_RANGE = 40.0, 0.08
#: Time after power-on from which self-heating changes little, s.
_WARM_S = 7200.0
#: Smallest change of another temperature, degC, of which each gyro must show some.
_MIN_OTHER_CHANGE_C = 5.0

_Pairs = Sequence[tuple[DwellRow, DwellRow]]


def _contradictions(rows: Sequence[DwellRow]) -> list[str]:
    """Sentences on columns that contradict each other, with the factor that corrects them.

    ``rows``: dwells without flags. Also finds contradictions in only one run.
    """

    def power_cycle(row: DwellRow) -> tuple[str, str]:
        return row.unit, row.run

    if problems := [*_stuck_sensors(rows), *_fahrenheit_columns(rows)]:
        return problems
    ordered = sorted(rows, key=lambda row: (*power_cycle(row), row.start_s))
    cycles = [list(pairwise(group)) for _, group in groupby(ordered, key=power_cycle)]
    problems_of_cycles = [
        [*_scale_problems(pairs, f" of run {pairs[0][0].run}")] for pairs in cycles if pairs
    ]
    wrong = [problems for problems in problems_of_cycles if problems]
    if not wrong or len(wrong) > 1 or len(cycles) == 1:
        problems_of_all = [*_scale_problems([pair for pairs in cycles for pair in pairs], "")]
        wrong = [problems_of_all] if problems_of_all else wrong
    return (
        wrong[0] if wrong else [problem for pairs in cycles for problem in _inconsistent_power_ons(pairs)][:1]
    )


def _stuck_sensors(rows: Sequence[DwellRow]) -> Iterator[str]:
    """Gyro temperatures that stay constant although others change."""
    others = {name: [getattr(row, name) for row in rows] for name in ("case_c", "chamber_c")}
    for index, axis in enumerate(AXES):
        others[f"board_{axis}_c"] = [row.board_c[index] for row in rows]
        if len({row.gyro_c[index] for row in rows}) > 1:
            continue
        for name, values in others.items():
            change_c = _range(values)
            if change_c > _MIN_OTHER_CHANGE_C:
                yield (
                    f"gyro_{axis}_c is {rows[0].gyro_c[index]:g} degC in all dwells, but {name} changes by "
                    f"{change_c:.0f} degC: correct its values, or check its sensor"
                )
                break


def _fahrenheit_columns(rows: Sequence[DwellRow]) -> Iterator[str]:
    """Gyro temperatures that change 1.8 times as much as the chamber or the case, which no warm gyro does."""
    rows = [row for row in rows if row.since_power_on_s >= _WARM_S]
    for name in ("chamber_set_c", "chamber_c", "case_c"):
        other_c = _range([getattr(row, name) for row in rows])
        if other_c < _MIN_PROFILE_C:
            continue
        ranges = [_range([row.gyro_c[index] for row in rows]) for index in range(len(AXES))]
        wrong = [
            (axis, gyro_c)
            for axis, gyro_c in zip(AXES, ranges, strict=True)
            if abs(gyro_c / other_c / _DEGF_PER_DEGC - 1.0) <= _SAME_RANGE
        ]
        if wrong:
            axes = _axes([axis for axis, _ in wrong])
            yield (
                f"gyro_{axes}_c changes by {wrong[0][1]:.0f} degC in all, but {name} by {other_c:.0f} degC: "
                f"gyro_{axes}_c seems to be in degF: correct its values"
            )
            return


def _values(rows: Sequence[DwellRow], name: str) -> FloatArray:
    return np.array([getattr(row, name) for row in rows], dtype=np.float64)


def _axes(names: Sequence[str]) -> str:
    """Axes in the name of their columns: "x", "{x,z}"."""
    return f"{{{','.join(names)}}}" if len(names) > 1 else names[0]


def _range(values: Sequence[float]) -> float:
    """Range of the finite values; 0 without any."""
    return float(np.ptp([value for value in values if math.isfinite(value)] or [0.0]))


def _scale_problems(pairs: _Pairs, where: str) -> Iterator[str]:
    clock = _clock_factor(pairs)
    rates = {axis: factor for index, axis in enumerate(AXES) if (factor := _rate_factor(pairs, index)) != 1.0}
    factors = list(rates.values())
    common = factors[0] if len(factors) == 3 and all(_is_near(each, factors[0]) for each in factors) else 1.0
    dwell_s = float(np.median([row.end_s - row.start_s for pair in pairs for row in pair] or [_MAX_DWELL_S]))
    is_odd = dwell_s < _MIN_DWELL_S or (dwell_s > _MAX_DWELL_S and common != 1.0)
    if clock != 1.0 and (_is_near(clock, common) or (is_odd and not rates)):
        others = " and the gyro temperatures" if rates else ""
        advice = _correction_advice(clock, _TIMES, "start_s and end_s")
        yield f"start_s and end_s{where} contradict since_power_on_s{others}: {advice}"
        return
    if is_odd:
        advice = _correction_advice(common, _TIMES, "start_s, end_s and since_power_on_s")
        yield f"the dwells{where} last {dwell_s:.3g} s (median): {advice}"
        return
    if clock != 1.0:
        advice = _correction_advice(1.0 / clock if clock else math.inf, _TIMES, "since_power_on_s")
        yield f"since_power_on_s{where} grows by {clock:.3g} s in each second of start_s: {advice}"
    for axis, factor in {"{x,y,z}": common}.items() if common != 1.0 else rates.items():
        column, rate = f"gyro_{axis}_c", f"gyro_{axis}_rate_c_per_h"
        change = (
            f"changes by {factor:.3g} times that rate" if math.isfinite(factor) else "changes at a rate of 0"
        )
        advice = _correction_advice(factor, _RATES, rate)
        if _is_near(factor, _DEGF_PER_DEGC):
            advice = f"{column} seems to be in degF: correct its values"
        yield f"{rate} contradicts {column}, which between neighbouring dwells{where} {change}: {advice}"


def _clock_factor(pairs: _Pairs) -> float:
    """Median ratio of the increase of since_power_on_s to that of start_s; 1 if they agree."""
    ratios = [(b.since_power_on_s - a.since_power_on_s) / (b.start_s - a.start_s) for a, b in pairs]
    factor = float(np.median(ratios)) if len(ratios) >= _MIN_PAIRS else 1.0
    return 1.0 if _is_near(factor, 1.0) else factor


def _rate_factor(pairs: _Pairs, gyro: int) -> float:
    """Median ratio of the change of a temperature to that predicted by its rates; 1 if they agree.

    From ramps or, if there are too few of them, from the settling after ramps.
    """
    changes = [*_neighbour_changes(pairs, gyro)]
    ramps = [*_ramp_ratios(changes)]
    if len(ramps) >= _MIN_PAIRS:
        is_right = [_MIN_FACTOR <= each <= _MAX_FACTOR for each in ramps]
        return 1.0 if np.mean(is_right) >= 0.5 else float(np.median(ramps))
    settling = [*_settling_ratios(changes)]
    if len(settling) < _MIN_SETTLING_PAIRS:
        return 1.0
    factor = float(np.median(settling))
    is_same = [abs(each - factor) <= _SAME_SETTLING * abs(factor) for each in settling]
    is_wrong = not 1.0 / _MAX_SETTLING_FACTOR <= factor <= _MAX_SETTLING_FACTOR
    return factor if is_wrong and np.mean(is_same) >= _MIN_SAME else 1.0


def _neighbour_changes(pairs: _Pairs, gyro: int) -> Iterator[tuple[float, float, float, float]]:
    """Rates of neighbouring dwells, degC/h; the time between their middles, h; the change between them, degC.

    Pairs with a long gap are skipped: neither rate holds in the gap.
    """
    for a, b in pairs:
        gap_s, dwell_s = b.start_s - a.end_s, 0.5 * (a.end_s - a.start_s + b.end_s - b.start_s)
        passed_h = (b.start_s + b.end_s - a.start_s - a.end_s) / 7200.0
        change_c = b.gyro_c[gyro] - a.gyro_c[gyro]
        if gap_s <= _MAX_GAP * dwell_s and math.isfinite(change_c):
            yield a.gyro_rate_c_per_h[gyro], b.gyro_rate_c_per_h[gyro], passed_h, change_c


def _ramp_ratios(changes: Sequence[tuple[float, float, float, float]]) -> Iterator[float]:
    """Ratios of the change to that predicted by the rates, for pairs with about equal rates."""
    for first, second, passed_h, change_c in changes:
        expected_c = 0.5 * (first + second) * passed_h
        is_ramp = abs(second - first) <= _MAX_RATE_CHANGE * max(abs(first), abs(second))
        if is_ramp and max(abs(change_c), abs(expected_c)) >= _MIN_CHANGE_C:
            yield change_c / expected_c if expected_c else math.inf


def _settling_ratios(changes: Sequence[tuple[float, float, float, float]]) -> Iterator[float]:
    """Ratios for pairs whose second rate is smaller; exact for a decay with one time constant."""
    for first, second, passed_h, change_c in changes:
        is_settling = first * second > 0.0 and abs(second) < abs(first)
        if is_settling and abs(change_c) >= _MIN_SETTLED_C:
            mean = (second - first) / math.log(second / first)
            yield change_c / (mean * passed_h)


def _inconsistent_power_ons(pairs: _Pairs) -> Iterator[str]:
    """Dwells of one run with different power-on times, unless the power-on was in the previous dwell."""
    first: DwellRow | None = None
    for before, row in pairs:
        first = first or before
        first_on_s, on_s = (each.start_s - each.since_power_on_s for each in (first, row))
        if abs(on_s - first_on_s) <= _POWER_ON_S + _CLOCK_DRIFT * (row.start_s - first.start_s):
            continue
        # If dwells are missing in between, their start and end are unknown.
        latest_s = before.end_s if row.dwell == before.dwell + 1 else row.start_s
        if not before.start_s - _POWER_ON_S <= on_s <= latest_s:
            yield (
                f"start_s minus since_power_on_s is {first_on_s:.7g} s for dwell {first.dwell}, but "
                f"{on_s:.7g} s for dwell {row.dwell} of the same run {row.run}: use one clock for both, and "
                "a new run after each power-on"
            )
            return
        first = row


def _is_near(factor: float, other: float) -> bool:
    return factor == other or abs(factor - other) <= _SAME_FACTOR * abs(other)


def _correction_advice(factor: float, units: Mapping[float, str], columns: str) -> str:
    """Advice for columns with a wrong scale."""
    if not math.isfinite(factor) or factor in (0.0, 1.0):
        return f"correct {columns}"
    if _is_near(factor, -1.0):
        return f"change the sign of {columns}"
    for usual, unit in units.items():
        if _is_near(abs(factor), usual):
            sign = " with the wrong sign" if factor < 0.0 else ""
            return (
                f"the unit seems to be {unit}{sign}: multiply {columns} by {math.copysign(usual, factor):.4g}"
            )
    return f"correct the unit of {columns}: a factor of {factor:.3g} is missing"
