"""Sentences about doubtful results of a run, the same in report and terminal."""

from __future__ import annotations

import math
import re
import shlex
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.noise_estimate import NoiseComparison, NoiseEstimate, compare_noise
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.vertical_pairs import Finding
from gyrobench.bench.foundations.text import capitalised, counted, flag_text, listed
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.report.number_format import corrected_p
from gyrobench.bench.report.temperature_findings import temperatures_sentence
from gyrobench.bench.runs.journal import RunFacts
from gyrobench.bench.runs.tables.joint_table import JointPlateauRow

#: Key of the station file and its default. An accelerometer counts as level in a dwell if the uncertainty of
#: its bias is below this multiple of the smallest one.
_DRIFT_KEY, _DEFAULT_DRIFT_UG_PER_H, _MAX_LEVEL_SIGMA_RATIO = "accelerometer_drift_ug_per_h", 20.0, 5.0
_SLOPE_KEY = "accelerometer_slope_ug_per_c"
#: Least number and temperature range, K, of dwells that show a slope over temperature.
_MIN_DWELLS, _MIN_RANGE_K = 4, 20.0
#: Noise is reported if it exceeds the declared value by the first factor, or is smaller by the second: data
#: sheets state upper limits.
_MAX_NOISE_RATIO, _MAX_DECLARED_RATIO = 1.3, 3.0
_NOISE_KEYS = MappingProxyType(
    {
        "angle random walk of all gyros": "angle_random_walk_deg_per_sqrt_h",
        "velocity random walk": "velocity_random_walk_ug_per_sqrt_hz",
    }
)
#: Dwells contradict one another if their p-value, corrected for the number of plateaus, is smaller; a rate Up
#: is reported above this many sigmas.
CONTRADICTION_P, _SIGNIFICANT_SIGMAS = 1e-3, 4.0
_NUMBERS = re.compile(r"[-+]?\d[\d.]*(e[-+]\d+)?")
#: At lower latitudes the Earth's rate Up is too small to show a unit that is mirrored East to West, deg.
_EQUATORIAL_DEG = 12.0


def run_findings(
    rows: Sequence[DwellRow],
    station: Mapping[str, Any],
    noise: NoiseEstimate | None,
    plateaus: Sequence[JointPlateauRow],
    reason: str = "",
    sensors: str = "",
) -> dict[str, str]:
    """Reasons to doubt the results of a run, by title: the sentences of this module.

    ``station``: content of the station file. ``plateaus``: see :func:`joint_solution_sentences`.
    ``reason``: why the run did not finish, which is stated elsewhere. ``sensors``: see
    :func:`gyrobench.bench.report.temperature_findings.sensors_sentence`.
    """
    sentences = {
        "Many dwells are flagged.": flags_sentence(rows, reason),
        "Temperatures of the gyros.": " ".join(filter(None, (temperatures_sentence(rows, station), sensors))),
        "Drifting accelerometers.": accelerometers_sentence(rows, station),
        "Declared noise.": noise_sentence(noise, station),
        **joint_solution_sentences(plateaus),
    }
    return {title: text for title, text in sentences.items() if text}


def flags_sentence(rows: Sequence[DwellRow], reason: str = "") -> str:
    """The most frequent flag, if at least half of the dwells are flagged; else empty.

    Flags that differ only in numbers count as the same. Empty if that flag is the ``reason`` why the run did
    not finish.
    """
    texts_by_kind: defaultdict[str, list[str]] = defaultdict(list)
    for text in (flag_text(row.flags) for row in rows if row.flags):
        texts_by_kind[_NUMBERS.sub("", text)].append(text)
    flagged = sum(map(len, texts_by_kind.values()))
    if not rows or 2 * flagged < len(rows):
        return ""
    most_frequent = max(texts_by_kind.values(), key=len)
    if flag_text([reason]) in most_frequent:
        return ""
    left_out = f"{flagged} of {counted(len(rows), 'dwell')}"
    return (
        f"Flagged, and not in the results: {left_out}. The most frequent flag ({len(most_frequent)}): "
        f"{most_frequent[0]}"
    )


def accelerometers_sentence(rows: Iterable[DwellRow], station: Mapping[str, Any]) -> str:
    """Accelerometer biases that follow the temperature and drift more than declared; else empty.

    ``station``: content of the station file. A drift of a level accelerometer looks like a gyro bias.
    """
    declared = station.get("ins", {}).get("uncertainty", {})
    declared_drift = declared.get(_DRIFT_KEY, _DEFAULT_DRIFT_UG_PER_H)
    declared_slope = declared.get(_SLOPE_KEY, 0.0)
    all_rows = list(rows)
    estimates = ((index, _significant_slope(all_rows, index)) for index in range(len(AXES)))
    slopes = {index: estimate for index, estimate in estimates if estimate}
    sizes = np.abs([slope for slope, _ in slopes.values()])
    rates_c_per_h = np.abs([[row.gyro_rate_c_per_h[index] for index in slopes] for row in all_rows])
    rates_c_per_h = np.nan_to_num(rates_c_per_h.reshape(len(all_rows), len(slopes)))
    drifts = sizes * rates_c_per_h
    allowed = 2.0 * np.hypot(declared_drift, declared_slope * rates_c_per_h)
    dwells = int(np.count_nonzero((drifts > allowed).any(axis=1)))
    if not dwells:
        return ""
    slope_texts = [
        f"{AXES[index]} {slope:+.2f} ± {sigma:.2f} ug/K" for index, (slope, sigma) in slopes.items()
    ]
    apparent_dph = math.degrees(1e-6 * float(drifts.max()))
    return (
        f"Accelerometer biases follow the temperature: {listed(slope_texts)}. In {counted(dwells, 'dwell')} "
        f"that is a drift of up to {drifts.max():.0f} ug/h, which looks like {apparent_dph:.3f} deg/h of a "
        f"level gyro; ins.uncertainty allows for {declared_drift:g} ug/h and {declared_slope:g} ug/K. "
        f"Declare {_SLOPE_KEY}: {_round_up(float(sizes.max())):g} in the station file; for this run in the "
        "station.yaml of its folder, then gyrobench seal --accept-changes and gyrobench bins."
    )


def _significant_slope(rows: Iterable[DwellRow], index: int) -> tuple[float, float] | None:
    """Slope of the biases of one accelerometer in ug/K and its sigma; None if not significant."""
    observations = [
        (
            row.case_c if math.isfinite(row.case_c) else row.gyro_c[index],
            row.accelerometer_ug[index],
            row.accelerometer_sigma_ug[index],
        )
        for row in rows
    ]
    values = np.array(observations).reshape(-1, 3)
    values = values[np.isfinite(values).all(axis=1)]
    # The bias of a vertical accelerometer is only the prior.
    is_level = values[:, 2] < _MAX_LEVEL_SIGMA_RATIO * values[:, 2].min(initial=np.inf)
    temperature_c, bias_ug, sigma_ug = values[is_level].T
    if len(temperature_c) < _MIN_DWELLS or np.ptp(temperature_c) < _MIN_RANGE_K:
        return None
    design = np.column_stack([np.ones_like(temperature_c), temperature_c]) / sigma_ug[:, np.newaxis]
    (_, slope), residual_chi2, *_ = np.linalg.lstsq(design, bias_ug / sigma_ug)
    scatter = max(1.0, float(residual_chi2.sum()) / (len(temperature_c) - 2))
    sigma = math.sqrt(scatter * float(np.linalg.inv(design.T @ design)[1, 1]))
    return (float(slope), sigma) if abs(slope) > _SIGNIFICANT_SIGMAS * sigma else None


def declared_noise(station: Mapping[str, Any]) -> NoiseModel | None:
    """Noise declared by a station file; None if the noise is estimated or the file is missing."""
    noise = station.get("ins", {}).get("noise")
    if not isinstance(noise, Mapping):
        return None
    return NoiseModel.from_datasheet(
        noise["angle_random_walk_deg_per_sqrt_h"],
        noise.get("velocity_random_walk_ug_per_sqrt_hz", 0.0),
        velocity_output_mps=noise.get("velocity_output_mps", 0.0),
        heading_output_rad=math.radians(noise.get("heading_output_deg", 0.0)),
    )


def noise_sentence(noise: NoiseEstimate | None, station: Mapping[str, Any]) -> str:
    """Random walks that are significantly larger or smaller than declared; else empty.

    ``station``: content of the station file.
    """
    declared = declared_noise(station)
    if noise is None or declared is None:
        return ""
    comparisons = {each.name: each for each in compare_noise(noise, declared)}
    return " ".join(filter(None, (_noise_text(comparisons[name], key) for name, key in _NOISE_KEYS.items())))


def _noise_text(comparison: NoiseComparison, key: str) -> str:
    measured, declared = comparison.measured, comparison.declared
    if measured.square is None:
        lower, upper = 0.0, math.inf if measured.limit is None else measured.limit
    else:
        margin = _SIGNIFICANT_SIGMAS * measured.square_sigma
        lower, upper = (math.sqrt(max(0.0, measured.square + each)) for each in (-margin, margin))
    if declared == 0.0 or (
        not (is_larger := lower > _MAX_NOISE_RATIO * declared) and declared <= _MAX_DECLARED_RATIO * upper
    ):
        return ""
    consequence = (
        "Dwells that show it clearly were evaluated with the measured noise; the uncertainties of others are "
        "too small."
        if is_larger
        else "The uncertainties of the biases are too large."
    )
    measured_text = measured.text(comparison.unit, comparison.unit_si).removeprefix(
        "hidden by the resolution, "
    )
    declaration = f"{key}: {measured.conservative_value / comparison.unit_si:.2g}"
    return (
        f"{capitalised(comparison.name)}: measured {measured_text}, declared "
        f"{declared / comparison.unit_si:.3g} {comparison.unit}. {consequence} Declare "
        f"ins.noise.{declaration}, and measure again."
    )


def _round_up(value: float) -> float:
    """Round a positive value up to two significant digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / step) * step


def joint_solution_sentences(plateaus: Sequence[JointPlateauRow]) -> dict[str, str]:
    """Faults of the bench that the joint solution indicates, by title: latitude, rate Up, contradiction.

    ``plateaus``: if there are several, the last one is the solution of all together.
    """
    sentences = {}
    for plateau in plateaus[-1:]:
        if Finding[plateau.finding.upper()] is Finding.LATITUDE_OFF:
            sentences["Wrong latitude."] = (
                f"The latitude of the INS is {plateau.latitude_error_arcmin:+.2f} ± "
                f"{plateau.latitude_error_sigma_arcmin:.2f} arcmin off, more than declared. The biases of "
                "vertical gyros are corrected for it; correct the latitude in station file and INS."
            )
        is_significant = abs(plateau.up_rate_dph) > _SIGNIFICANT_SIGMAS * plateau.up_rate_sigma_dph
        if Finding[plateau.finding.upper()] is Finding.NOT_LATITUDE and is_significant:
            sentences["Rate Up."] = (
                "The biases of vertical gyros differ between up and down by the same rate Up of "
                f"({1e3 * plateau.up_rate_dph:+.2f} ± {1e3 * plateau.up_rate_sigma_dph:.2f}) · 10⁻³ deg/h in "
                "all gyros, which no latitude explains and their biases include. Check that table, fixture "
                "and pier do not turn slowly; a bias that follows gravity equally in all gyros looks the "
                "same."
            )
    factor, ratio = (  # columns that older tables lack are NaN
        max((value for value in values if value > 1.0), default=1.0)
        for values in (
            [each.gyro_error_factor for each in plateaus],
            [each.scale_factor_ratio for each in plateaus],
        )
    )
    if factor > 1.0:
        sentences["Misaligned gyros."] = (
            "The misalignments or scale factors of the gyros are larger than declared, by the half turns of "
            f"all dwells of a plateau: about {factor:.2g} times. The uncertainties allow for that. Multiply "
            "gyro_misalignment_arcsec and gyro_scale_factor_ppm of ins.uncertainty by it, or calibrate the "
            "gyros by rotations."
        )
    if ratio > 1.0:
        sentences["Scale factors of the gyros."] = (
            "The INS turned by other angles than the table: scale factors of the gyros are about "
            f"{factor * ratio:.2g} times the declared ones, or the table's angles are wrong. The "
            "uncertainties allow for that. Check the table against a polygon, and multiply "
            "gyro_scale_factor_ppm of ins.uncertainty by that number, or calibrate the gyros by rotations."
        )
    corrected = [
        max(fit_p, any_north_p)
        for each, fit_p, any_north_p in corrected_p_values(plateaus)
        if each.dwells > 1
    ]
    contradictory = [each for each in corrected if each < CONTRADICTION_P]
    if contradictory:
        sentences["Dwells contradict one another."] = (
            f"At {counted(len(contradictory), 'plateau')} they disagree on the accelerometer biases, "
            f"misalignments and rates that they share{corrected_p(min(contradictory), len(corrected))}: "
            "biases of positions may seem to differ. Accelerometer biases that follow the temperature do "
            "that: soak longer, or measure on slower ramps. See the joint solution in the report."
        )
    return sentences


def corrected_p_values(plateaus: Sequence[JointPlateauRow]) -> list[tuple[JointPlateauRow, float, float]]:
    """Plateaus with a test of their dwells, and its p-values corrected for the number of plateaus.

    The p-values are those with the declared latitude, and with any rate North.
    """
    tested = [each for each in plateaus if math.isfinite(each.fit_p_value)]
    return [(each, len(tested) * each.fit_p_value, len(tested) * each.any_north_p_value) for each in tested]


def signs_sentence(facts: RunFacts, station: Mapping[str, Any], name: str | Path) -> str:
    """Signs and axes of the signal map that no dwell tested; empty if all were, or no dwell has a result.

    ``station``: content of the station file. ``name``: that file as written in a command.
    """
    if facts.are_signs_tested is None:
        return ""
    if not facts.are_signs_tested:
        return (
            "Signs and axes of the signal map were not tested: the windows are too short, the output is too "
            "coarse, or the velocities do not follow from the tilt. If they are wrong, so are the "
            f"biases: test them with gyrobench check {shlex.quote(str(name))} --signs."
        )
    match station:
        case {"location": {"latitude_deg": int() | float() as latitude_deg}}:
            if abs(latitude_deg) < _EQUATORIAL_DEG:
                return (
                    f"At {latitude_deg:.3g} deg of latitude no dwell shows whether heading and table axes "
                    "both have the wrong sense. Biases of vertical gyros would have the wrong sign: check by "
                    "eye that the table turns as the station file states."
                )
    return ""


def identities_sentence(facts: RunFacts) -> str:
    """INS that identified otherwise in some dwells, as with another firmware; empty if none did."""
    counts = {identity: count for identity, count in facts.dwells_by_identity.items() if count}
    if len(counts) < 2:
        return ""
    texts = [f"as {identity} in {counted(count, 'dwell')}" for identity, count in counts.items()]
    return (
        f"The INS identified {listed(texts)}. Another firmware may have other biases and compensations, and "
        "the results take all dwells together: measure those of one of them again with gyrobench resume "
        "--repeat."
    )
