"""What makes the results of a run doubtful, in sentences: the same in report and terminal."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from gyrobench.bench.bias.allan import RANDOM_WALK
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.noise_estimate import NoiseComparison, NoiseEstimate, compare_noise
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.vertical_pairs import Finding
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.text import capitalised, counted, flag_text, listed, plural
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.report.number_format import p_in_brackets
from gyrobench.bench.runs.journal import RunFacts
from gyrobench.bench.runs.tables.joint_table import JointPlateauRow

#: Key of the station file, its default, and by how much more certain biases of level accelerometers are than
#: of vertical ones, at least.
_DRIFT, _USUAL_DRIFT_UG_PER_H, _LEVEL = "accelerometer_drift_ug_per_h", 20.0, 5.0
_SLOPE = "accelerometer_slope_ug_per_c"
#: A heading of which the random walk, as a square, is less than this part of the gyros' does not follow them.
_HELD = 0.1
#: Rate, K/h, below which the temperature of a gyro has settled, number and range of settled dwells that are
#: needed, and the change of a gyro's temperature for each kelvin of the chamber in a unit: 0.86 to 1.06 in
#: simulated ones.
_SETTLED_C_PER_H, _MIN_SETTLED, _MIN_RANGE_K, _FOLLOWING = 12.0, 4, 20.0, (0.7, 1.3)
#: Optics this much warmer than their electronics, K, are unusual: in simulated units they are 5 K colder or
#: more. Gyros may be this much warmer than declared, or colder than the chamber's air.
_SELF_HEATING, _USUAL_HEATING_K, _ABOVE_BOARD_K, _OFFSET_K = "self_heating_c", 15.0, 2.0, 5.0
#: Noise that is larger than declared by the first factor, or smaller by the second, is named; data sheets
#: state upper limits.
_LARGER, _SMALLER = 1.3, 3.0
_NOISE_KEYS = MappingProxyType(
    {
        "angle random walk of all gyros": "angle_random_walk_deg_per_sqrt_h",
        "velocity random walk": "velocity_random_walk_ug_per_sqrt_hz",
    }
)
#: Dwells contradict one another below this probability; a rate Up is named above this number of sigmas.
_CONTRADICTION_P, _CLEAR_SIGMAS = 1e-3, 4.0
_NUMBERS = re.compile(r"[-+]?\d[\d.]*(e[-+]\d+)?")
#: At lower latitudes the Earth's rate Up is too small to show a unit that is mirrored East to West, deg.
_EQUATORIAL_DEG = 12.0


def run_findings(
    rows: Sequence[DwellRow],
    station: Mapping[str, Any],
    noise: NoiseEstimate | None,
    plateaus: Sequence[JointPlateauRow],
    reason: str = "",
) -> dict[str, str]:
    """What makes the results of a run doubtful, by title: see the sentences of this module.

    ``station``: content of the station file. ``plateaus``: as for :func:`setup_sentences`. ``reason``: why
    the run did not finish, which is stated elsewhere.
    """
    found = {
        "Many dwells are flagged.": flags_sentence(rows, reason),
        "Temperatures of the gyros.": temperatures_sentence(rows, station),
        "Drifting accelerometers.": accelerometers_sentence(rows, station),
        "Declared noise.": noise_sentence(noise, station),
        "Held heading.": heading_sentence(noise),
        **setup_sentences(plateaus),
    }
    return {title: text for title, text in found.items() if text}


def flags_sentence(rows: Sequence[DwellRow], reason: str = "") -> str:
    """The most frequent flag where flags keep half of the dwells out of the results; else empty.

    Flags that differ in their numbers alone count as the same. Empty where that flag is the ``reason`` why
    the run did not finish.
    """
    kinds: defaultdict[str, list[str]] = defaultdict(list)
    for text in (flag_text(row.flags) for row in rows if row.flags):
        kinds[_NUMBERS.sub("", text)].append(text)
    flagged = sum(map(len, kinds.values()))
    if not rows or 2 * flagged < len(rows):
        return ""
    most = max(kinds.values(), key=len)
    if flag_text([reason]) in most:
        return ""
    left_out = f"{flagged} of {counted(len(rows), 'dwell')}"
    return f"Flagged, and not in the results: {left_out}. The most frequent flag ({len(most)}): {most[0]}"


def temperatures_sentence(rows: Iterable[DwellRow], station: Mapping[str, Any]) -> str:
    """What no settled unit's temperatures do, and a wrong scale, offset or map of signals does; else empty.

    ``station``: content of the station file.
    """
    settled = [
        (row.chamber_c, *row.gyro_c, *row.board_c)  # not the row: those of long runs are read one by one
        for row in rows
        if math.isfinite(row.chamber_c) and np.abs(row.gyro_rate_c_per_h).max() < _SETTLED_C_PER_H
    ]
    if len(settled) < _MIN_SETTLED:
        return ""
    chamber_c, gyro_c, board_c = np.split(np.array(settled), [1, 4], axis=1)
    declared_k = station.get("unit", {}).get("thermal", {}).get(_SELF_HEATING, _USUAL_HEATING_K)
    return (
        _scale_sentence(chamber_c, gyro_c)
        or _exchange_sentence(gyro_c - board_c)
        or _offset_sentence(gyro_c - chamber_c, declared_k)
    )


def _scale_sentence(chamber_c: FloatArray, gyro_c: FloatArray) -> str:
    """Gyros (n, 3) that do not follow the chamber (n, 1)."""
    if np.ptp(chamber_c) < _MIN_RANGE_K:
        return ""
    least, most = _FOLLOWING
    slopes = np.polyfit(chamber_c[:, 0], gyro_c, 1)[0]
    wrong = [
        f"that of the {axis} gyro by {slope:.2f} K"
        for axis, slope in zip(AXES, slopes, strict=True)
        if not least < slope < most
    ]
    if not wrong:
        return ""
    return (
        f"In settled dwells temperatures change for each kelvin of the chamber: {listed(wrong)}. Check scale "
        "and unit of the temperature signals in the DBC file: bins and plateaus are at wrong temperatures."
    )


def _exchange_sentence(above_board_k: FloatArray) -> str:
    """Optics that are warmer than the electronics by these differences (n, 3), NaN without a signal."""
    least_k = above_board_k.min(axis=0)  # where it is NaN, it compares as False
    exchanged = [axis for axis, above_k in zip(AXES, least_k, strict=True) if above_k > _ABOVE_BOARD_K]
    if not exchanged:
        return ""
    return (
        f"In all settled dwells the optics are warmer than the electronics, by {np.nanmax(least_k):.1f} "
        f"K or more ({plural(len(exchanged), 'gyro', 'gyros')} {listed(exchanged)}). Unless the optics "
        "are heated, the two signals are exchanged in signal map or DBC file, and bins are at the "
        "temperatures of the electronics."
    )


def _offset_sentence(above_air_k: FloatArray, declared_k: float) -> str:
    """Gyros that are above the air by these differences (n, 3), far from what is declared."""
    least_k, most_k = above_air_k.min(), above_air_k.max()
    if not (least_k > declared_k + _OFFSET_K or most_k < -_OFFSET_K):
        return ""
    return (
        f"In all settled dwells the gyros are {least_k:.1f} to {most_k:.1f} K above the chamber's air; "
        f"unit.thermal.{_SELF_HEATING} of the station is {declared_k:g} K. Correct it if that is so; else "
        "check the offset of the temperature signals in the DBC file and the chamber's sensor."
    )


def accelerometers_sentence(rows: Iterable[DwellRow], station: Mapping[str, Any]) -> str:
    """That accelerometer biases which follow the temperature drift more than declared; else empty.

    ``station``: content of the station file. A drift of a level accelerometer looks like a gyro bias.
    """
    declared = station.get("ins", {}).get("uncertainty", {})
    drift, slope = declared.get(_DRIFT, _USUAL_DRIFT_UG_PER_H), declared.get(_SLOPE, 0.0)
    known = list(rows)
    slopes = {index: found for index in range(len(AXES)) if (found := _clear_slope(known, index))}
    rises = np.abs([rise for rise, _ in slopes.values()])
    rates = np.abs([[row.gyro_rate_c_per_h[index] for index in slopes] for row in known])
    rates = np.nan_to_num(rates.reshape(len(known), len(slopes)))
    drifts = rises * rates
    dwells = int(np.count_nonzero((drifts > 2.0 * np.hypot(drift, slope * rates)).any(axis=1)))
    if not dwells:
        return ""
    follows = [f"{AXES[index]} {rise:+.2f} ± {sigma:.2f} ug/K" for index, (rise, sigma) in slopes.items()]
    looks_dph = math.degrees(1e-6 * float(drifts.max()))
    return (
        f"Accelerometer biases follow the temperature: {listed(follows)}. In {counted(dwells, 'dwell')} that "
        f"is a drift of up to {drifts.max():.0f} ug/h, which looks like {looks_dph:.3f} deg/h of a level "
        f"gyro; ins.uncertainty allows for {drift:g} ug/h and {slope:g} ug/K. Declare {_SLOPE}: "
        f"{_rounded_up(float(rises.max())):g} in the station file; for this run in the station.yaml of its "
        "folder, then gyrobench seal --accept-changes and gyrobench bins."
    )


def _clear_slope(rows: Iterable[DwellRow], index: int) -> tuple[float, float] | None:
    """Slope of the biases of one accelerometer in ug/K, and its sigma; None where it is not significant."""
    known = [
        (
            row.case_c if math.isfinite(row.case_c) else row.gyro_c[index],
            row.accelerometer_ug[index],
            row.accelerometer_sigma_ug[index],
        )
        for row in rows
    ]
    values = np.array(known).reshape(-1, 3)
    values = values[np.isfinite(values).all(axis=1)]
    # That of a vertical accelerometer is what was known beforehand.
    is_level = values[:, 2] < _LEVEL * values[:, 2].min(initial=np.inf)
    at_c, bias_ug, sigma_ug = values[is_level].T
    if len(at_c) < _MIN_SETTLED or np.ptp(at_c) < _MIN_RANGE_K:
        return None
    columns = np.column_stack([np.ones_like(at_c), at_c]) / sigma_ug[:, np.newaxis]
    (_, rise), left, *_ = np.linalg.lstsq(columns, bias_ug / sigma_ug)
    scatter = max(1.0, float(left.sum()) / (len(at_c) - 2))
    sigma = math.sqrt(scatter * float(np.linalg.inv(columns.T @ columns)[1, 1]))
    return (float(rise), sigma) if abs(rise) > _CLEAR_SIGMAS * sigma else None


def declared_noise(station: Mapping[str, Any]) -> NoiseModel | None:
    """Noise that a station file declares; None where it is estimated, or the file is missing."""
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
    """Random walks that the data show clearly larger or smaller than declared; else empty.

    ``station``: content of the station file.
    """
    declared = declared_noise(station)
    if noise is None or declared is None:
        return ""
    compared = {each.name: each for each in compare_noise(noise, declared)}
    return " ".join(filter(None, (_noise_text(compared[name], key) for name, key in _NOISE_KEYS.items())))


def _noise_text(compared: NoiseComparison, key: str) -> str:
    measured, declared = compared.measured, compared.declared
    if measured.square is None:
        least, most = 0.0, math.inf if measured.limit is None else measured.limit
    else:
        margin = _CLEAR_SIGMAS * measured.square_sigma
        least, most = (math.sqrt(max(0.0, measured.square + each)) for each in (-margin, margin))
    if declared == 0.0 or (not (is_larger := least > _LARGER * declared) and declared <= _SMALLER * most):
        return ""
    effect = (
        "Dwells that show it clearly were evaluated with the measured noise; the uncertainties of others are "
        "too small."
        if is_larger
        else "The uncertainties of the biases are too large."
    )
    shown = measured.text(compared.unit, compared.unit_si).removeprefix("hidden by the resolution, ")
    to_declare = f"{key}: {measured.conservative_value / compared.unit_si:.2g}"
    return (
        f"{capitalised(compared.name)}: measured {shown}, declared "
        f"{declared / compared.unit_si:.3g} {compared.unit}. {effect} Declare ins.noise.{to_declare}, and "
        "measure again."
    )


def _rounded_up(value: float) -> float:
    """To two digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / step) * step


def heading_sentence(noise: NoiseEstimate | None) -> str:
    """That the heading walks at random far less than the gyros do: it is held or aided; else empty."""
    if noise is None:
        return ""
    heading, gyros = noise.heading.parameter(RANDOM_WALK), noise.angle_random_walk
    if gyros.square is None or not gyros.is_significant:
        return ""
    # None where its steps hide it, as those of a heading that is held exactly.
    limit = (
        heading.limit
        if heading.square is None
        else math.sqrt(max(heading.square, 0.0) + _CLEAR_SIGMAS * heading.square_sigma)
    )
    if limit is None or limit**2 > _HELD * gyros.square:
        return ""
    ratio = limit / math.sqrt(gyros.square)
    return (
        f"The heading walks at random at most {ratio:.2g} times as much as the angles about the gyros' axes "
        "do: the INS seems to hold or aid it, and then biases of vertical gyros do not show. Switch it off, "
        "and measure again."
    )


def setup_sentences(plateaus: Sequence[JointPlateauRow]) -> dict[str, str]:
    """What the joint solution finds wrong with the bench, by title: the latitude, a rate Up, a contradiction.

    ``plateaus``: the last one is all together, if there are several.
    """
    found = {}
    for last in plateaus[-1:]:
        if Finding[last.finding.upper()] is Finding.LATITUDE_OFF:
            found["Wrong latitude."] = (
                f"The latitude of the INS is {last.latitude_error_arcmin:+.2f} ± "
                f"{last.latitude_error_sigma_arcmin:.2f} arcmin off, more than declared. The biases of "
                "vertical gyros are corrected for it; correct the latitude in station file and INS."
            )
        is_clear = abs(last.up_rate_dph) > _CLEAR_SIGMAS * last.up_rate_sigma_dph
        if Finding[last.finding.upper()] is Finding.NOT_LATITUDE and is_clear:
            found["Rate Up."] = (
                f"Vertical gyros up and down differ as by a rate Up of ({1e3 * last.up_rate_dph:+.2f} ± "
                f"{1e3 * last.up_rate_sigma_dph:.2f}) · 10⁻³ deg/h, alike in all gyros, that no latitude "
                "explains. Their biases contain it. Check that table, fixture and pier do not turn slowly; "
                "biases that follow gravity alike in all gyros look the same."
            )
    wrong = [each for each in plateaus if max(each.fit_p_value, each.any_north_p_value) < _CONTRADICTION_P]
    if wrong:
        least = min(max(each.fit_p_value, each.any_north_p_value) for each in wrong)
        found["Dwells contradict one another."] = (
            f"At {counted(len(wrong), 'plateau')} they disagree on the accelerometer biases, misalignments "
            f"and rates that they share{p_in_brackets(least)}: biases of positions may seem to differ. "
            "Accelerometer biases that follow the temperature do that: soak longer, or measure on slower "
            "ramps. See the joint solution in the report."
        )
    return found


def signs_sentence(facts: RunFacts, station: Mapping[str, Any], name: str | Path) -> str:
    """What no dwell tested of the signal map; empty if all was tested, or none has a result.

    ``station``: content of the station file. ``name``: how to name that file in a command.
    """
    if facts.are_signs_tested is None:
        return ""
    if not facts.are_signs_tested:
        return (
            "Signs and axes of the signal map were not tested: the windows are too short, the output is too "
            "coarse, or the velocities do not follow from the tilt. If they are wrong, so are the "
            f"biases: test them with gyrobench check {name} --signs."
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
