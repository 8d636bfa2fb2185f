"""Results and findings in sentences, the same in report and terminal."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import median
from types import MappingProxyType
from typing import Any

import numpy as np

from gyrobench.bench.bias.allan import RANDOM_WALK
from gyrobench.bench.bias.bins import BiasBin, PositionComparison, not_connected
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.noise_estimate import NoiseComparison, NoiseEstimate, compare_noise
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.statistics import uniformity_p_value
from gyrobench.bench.bias.verdicts import Acceptance, RunVerdict
from gyrobench.bench.bias.vertical_pairs import Finding
from gyrobench.bench.foundations.text import agreeing, counted, flag_text, listed
from gyrobench.bench.navigation.positions import AXES, gyro_label, position_label
from gyrobench.bench.report.number_format import (
    dph_with_sigma,
    p_in_brackets,
    p_phrase,
    size_text,
    temperature_ranges,
)
from gyrobench.bench.runs.journal import RunFacts
from gyrobench.bench.runs.tables.joint_table import JointPlateauRow

#: Result without positions to compare.
NOTHING_TO_COMPARE = "Nothing to compare: no temperature bin has dwells in two positions of one power cycle."

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

#: Significance level of the differences between positions, per gyro.
POSITION_SIGNIFICANCE = 0.01

#: At lower latitudes the Earth's rate Up is too small to show a unit that is mirrored East to West, deg.
_EQUATORIAL_DEG = 12.0
_AS_EXPECTED = "Error model and noise explain the data."
_TOO_SMALL = (
    "The noise is larger than assumed, or the error model lacks an effect; the uncertainties are too small."
)
_TOO_LARGE = "The noise is smaller than assumed; the uncertainties are too large."


def differing(comparisons: Iterable[PositionComparison]) -> list[PositionComparison]:
    """Comparisons with a significant difference, corrected for the bins of the gyro (Bonferroni)."""
    comparisons = list(comparisons)
    gyros = [each.gyro for each in comparisons]
    return [each for each in comparisons if each.p_value < POSITION_SIGNIFICANCE / gyros.count(each.gyro)]


def equality_sentence(comparisons: Sequence[PositionComparison]) -> str:
    """Result of the comparisons of one gyro."""
    if not comparisons:
        return NOTHING_TO_COMPARE
    count = len(comparisons)
    corrected = f"corrected for {count} comparisons" if count > 1 else "one comparison"
    different = differing(comparisons)
    if not different:
        where = temperature_ranges(comparisons)
        return (
            f"No significant difference between positions from {where} (no p < {POSITION_SIGNIFICANCE:g}, "
            f"{corrected})."
        )
    worst = max(different, key=lambda each: each.largest_difference_dph)
    high, low = map(position_label, worst.largest_pair)
    difference = dph_with_sigma(worst.largest_difference_dph, worst.largest_difference_sigma_dph)
    return (
        f"The bias differs between positions in {len(different)} of {count} bins: from "
        f"{temperature_ranges(different)} (p < {POSITION_SIGNIFICANCE:g}, {corrected}). Largest difference "
        f"from {temperature_ranges([worst])}: {high} above {low} by {difference} (k = 1)."
    )


def power_cycle_sentence(bins: Iterable[BiasBin]) -> str:
    """Where positions of different power cycles are not compared; empty if nowhere."""
    apart = not_connected(bins)
    if not apart:
        return ""
    return (
        f"From {temperature_ranges(apart)} several power cycles measured different positions. Only positions "
        "of the same power cycle are compared there."
    )


def scatter_sentence(bins: Iterable[BiasBin]) -> str:
    """Where dwells of one position scatter more than their uncertainties explain; empty if nowhere."""
    tested = [each for each in bins if each.count > 1]
    wide = [each for each in tested if each.spread_p_value < POSITION_SIGNIFICANCE / len(tested)]
    if not wide:
        return ""
    places = ", ".join(f"{position_label(each.position)} {temperature_ranges([each])}" for each in wide)
    return (
        "Dwells of the same position and bin scatter more than their uncertainties explain; the "
        f"uncertainty of the mean and the p-value are too small at {places}."
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
    if np.ptp(chamber_c) >= _MIN_RANGE_K:
        least, most = _FOLLOWING
        slopes = np.polyfit(chamber_c[:, 0], gyro_c, 1)[0]
        wrong = [
            f"that of the {axis} gyro by {slope:.2f} K"
            for axis, slope in zip(AXES, slopes, strict=True)
            if not least < slope < most
        ]
        if wrong:
            return (
                f"In settled dwells temperatures change for each kelvin of the chamber: {listed(wrong)}. "
                "Check scale and unit of the temperature signals in the DBC file: bins and plateaus are at "
                "wrong temperatures."
            )
    # Signals that are not sent are NaN, and compare as False.
    least_k = (gyro_c - board_c).min(axis=0)
    if exchanged := [axis for axis, above_k in zip(AXES, least_k, strict=True) if above_k > _ABOVE_BOARD_K]:
        return (
            f"In all settled dwells the optics are warmer than the electronics, by {np.nanmax(least_k):.1f} "
            f"K or more ({agreeing(len(exchanged), 'gyro', 'gyros')} {listed(exchanged)}). Unless the optics "
            "are heated, the two signals are exchanged in signal map or DBC file, and bins are at the "
            "temperatures of the electronics."
        )
    above_k = gyro_c - chamber_c
    declared_k = station.get("unit", {}).get("thermal", {}).get(_SELF_HEATING, _USUAL_HEATING_K)
    too_warm, too_cold = above_k.min() > declared_k + _OFFSET_K, above_k.max() < -_OFFSET_K
    if not (too_warm or too_cold):
        return ""
    return (
        f"In all settled dwells the gyros are {above_k.min():.1f} to {above_k.max():.1f} K above the "
        f"chamber's air; unit.thermal.{_SELF_HEATING} of the station is {declared_k:g} K. Correct it if that "
        "is so; else check the offset of the temperature signals in the DBC file and the chamber's sensor."
    )


def accelerometers_sentence(rows: Iterable[DwellRow], station: Mapping[str, Any]) -> str:
    """That accelerometer biases which follow the temperature drift more than declared; else empty.

    ``station``: content of the station file. A drift of a level accelerometer looks like a gyro bias.
    """
    declared = station.get("ins", {}).get("uncertainty", {})
    drift, slope = declared.get(_DRIFT, _USUAL_DRIFT_UG_PER_H), declared.get(_SLOPE, 0.0)
    found, most_ug_per_h, known = {}, 0.0, list(rows)
    is_beyond = np.zeros(len(known), dtype=bool)
    for index, axis in enumerate(AXES):
        of_axis = np.array(
            [
                (
                    row.case_c if math.isfinite(row.case_c) else row.gyro_c[index],
                    row.accelerometer_ug[index],
                    row.accelerometer_sigma_ug[index],
                )
                for row in known
            ]
        ).reshape(-1, 3)
        of_axis = of_axis[np.isfinite(of_axis).all(axis=1)]
        # That of a vertical accelerometer is what was known beforehand.
        is_level = of_axis[:, 2] < _LEVEL * of_axis[:, 2].min(initial=np.inf)
        at_c, bias_ug, sigma_ug = of_axis[is_level].T
        if len(at_c) < _MIN_SETTLED or np.ptp(at_c) < _MIN_RANGE_K:
            continue
        columns = np.column_stack([np.ones_like(at_c), at_c]) / sigma_ug[:, np.newaxis]
        (_, rise), left, *_ = np.linalg.lstsq(columns, bias_ug / sigma_ug)
        scatter = max(1.0, float(left.sum()) / (len(at_c) - 2))
        sigma = math.sqrt(scatter * float(np.linalg.inv(columns.T @ columns)[1, 1]))
        if abs(rise) > _CLEAR_SIGMAS * sigma:
            found[f"{axis} {rise:+.2f} ± {sigma:.2f} ug/K"] = abs(float(rise))
            rates = np.nan_to_num([abs(row.gyro_rate_c_per_h[index]) for row in known])
            is_beyond |= abs(rise) * rates > 2.0 * np.hypot(drift, slope * rates)
            most_ug_per_h = max(most_ug_per_h, float(abs(rise) * rates.max()))
    if not is_beyond.any():
        return ""
    dwells = counted(int(np.count_nonzero(is_beyond)), "dwell")
    looks_dph = math.degrees(1e-6 * most_ug_per_h)
    return (
        f"Accelerometer biases follow the temperature: {listed(list(found))}. In {dwells} that is a drift of "
        f"up to {most_ug_per_h:.0f} ug/h, which looks like {looks_dph:.3f} deg/h of a level gyro; "
        f"ins.uncertainty allows for {drift:g} ug/h and {slope:g} ug/K. Declare {_SLOPE}: "
        f"{_rounded_up(max(found.values())):g} in the station file; for this run in the station.yaml of its "
        "folder, then gyrobench seal --accept-changes and gyrobench bins."
    )


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
    name = f"{compared.name[0].upper()}{compared.name[1:]}"
    shown = measured.text(compared.unit, compared.unit_si).removeprefix("hidden by the resolution, ")
    to_declare = f"{key}: {measured.cautious / compared.unit_si:.2g}"
    return (
        f"{name}: measured {shown}, declared "
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
    if gyros.square is None or not gyros.is_found:
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


def agreement_sentence(
    comparisons: Sequence[PositionComparison], by_paper: Sequence[PositionComparison]
) -> str:
    """Whether the paper's method finds the same bins different; empty without its results."""
    if not by_paper:
        return ""
    ours = {each.bin_low_c: each for each in differing(comparisons)}
    theirs = {each.bin_low_c: each for each in differing(by_paper)}
    more = [each for low, each in theirs.items() if low not in ours]
    fewer = [each for low, each in ours.items() if low not in theirs]
    if not more and not fewer:
        return "The paper's method agrees."
    parts = [f"it also finds a difference from {temperature_ranges(more)}"] if more else []
    parts += [f"it finds none from {temperature_ranges(fewer)}"] if fewer else []
    return f"The paper's method disagrees: {', and '.join(parts)}."


def fit_sentence(rows: Iterable[DwellRow]) -> str:
    """Whether error model and noise explain the data of the dwells; empty without tests."""
    tested = [row for row in rows if not math.isnan(row.fit_p_value)]
    if not tested:
        return ""
    p_values = [row.fit_p_value for row in tested]
    chance = uniformity_p_value(p_values)
    if chance < POSITION_SIGNIFICANCE:
        size, verdict = ("too small", _TOO_SMALL) if median(p_values) < 0.5 else ("too large", _TOO_LARGE)
    else:
        size, verdict = "as expected", f"{_AS_EXPECTED}{_outlier_sentence(tested)}"
    ratios = [row.fit_ratio for row in tested]
    if len(tested) == 1:
        size = f"{ratios[0]:.2f} times as large as expected ({p_phrase(p_values[0])})"
        return f"Residuals of the only dwell tested are {size}. {verdict}"
    return (
        f"Residuals of {len(tested)} dwells are {min(ratios):.2f} to {max(ratios):.2f} times as large as "
        f"expected, median {median(ratios):.2f}; their p-values are {size} (Kolmogorov-Smirnov "
        f"{p_phrase(chance)}). {verdict}"
    )


def _outlier_sentence(rows: Sequence[DwellRow]) -> str:
    outliers = [row for row in rows if row.fit_p_value < POSITION_SIGNIFICANCE / len(rows)]
    if not outliers:
        return ""
    which = f"dwell{'s' if len(outliers) > 1 else ''} {listed([str(row.dwell) for row in outliers])}"
    smallest = min(row.fit_p_value for row in outliers)
    return f" Outlying: {which} (smallest {p_phrase(smallest)})."


#: Colours of the template's box, by verdict.
VERDICT_COLOURS: Mapping[RunVerdict, str] = MappingProxyType(
    {"accepted": "finished", "marginal": "stopped", "rejected": "failed", "not judged": "open"}
)
_NO_LIMITS = "The procedure has no acceptance limits."
_NOTHING = "No plateau has good dwells in two positions."
_UNDECIDED = "The uncertainty is too large for a verdict. {}."
_DECIDED = "{:.0f} cycles in one run, instead of {}, give one if the differences stay as measured"
_COMMON = (
    "More cycles do not decide, because {} deg/h of it are the same in all of them: reduce its largest "
    "contributions in budget.csv"
)
_MAX_CYCLES = 20
_LACKING = (
    "{} not compared with the others of the plateau, so the unit can't be accepted. Measure all positions of "
    "{} again in one power cycle."
)
_MAX_PLATEAUS = 3


def acceptance_sentence(acceptance: Acceptance) -> str:
    """Reason of the verdict on the unit."""
    if acceptance.limits is None:
        return _NO_LIMITS
    limit = _limit(acceptance)
    with_confidence = f"with {100.0 * acceptance.limits.confidence:g} % confidence"
    match acceptance.verdict:
        case "accepted":
            return f"All gyros are within {limit} at {_plateaus(acceptance)}, {with_confidence}."
        case "rejected":
            return f"{_gyros(acceptance, 'fail')} beyond {limit}, {with_confidence}."
        case "marginal":
            advice = _UNDECIDED.format(_deciding_cycles(acceptance))
            return f"{_gyros(acceptance, 'marginal')} near {limit}. {advice}"
    return _lacking_sentence(acceptance) if acceptance.judgements else _NOTHING


def _deciding_cycles(acceptance: Acceptance) -> str:
    marginal = [each for each in acceptance.judgements if each.verdict == "marginal"]
    last = max(marginal, key=lambda each: each.cycles_to_decide)
    if last.is_limited_by_common_errors:
        return _COMMON.format(size_text(last.common_sigma_dph))
    if last.cycles_to_decide > _MAX_CYCLES:
        return "Measure more cycles"
    return _DECIDED.format(last.cycles_to_decide, last.passes)


def _limit(acceptance: Acceptance) -> str:
    limits = acceptance.limits
    if limits is None:
        return ""
    text = f"the limit of {limits.position_difference_dph:g} deg/h between positions"
    if limits.vertical_difference_dph is not None:
        text += f" ({limits.vertical_difference_dph:g} with the gyro up and down)"
    return text if limits.bias_dph is None else f"{text} or that of {limits.bias_dph:g} deg/h for the bias"


def _lacking_sentence(acceptance: Acceptance) -> str:
    places = ((each.cycle, each.chamber_set_c, each.position) for each in acceptance.not_measured)
    dwells = list(dict.fromkeys(places))
    plateaus = list(dict.fromkeys((cycle, set_c) for cycle, set_c, _ in dwells))
    named = [
        f"cycle {cycle}" + ("" if set_c is None else f" at {set_c:zg} °C in the chamber")
        for cycle, set_c in plateaus[:_MAX_PLATEAUS]
    ]
    if more := len(plateaus) - len(named):
        named.append(counted(more, "other plateau"))
    were = agreeing(len(dwells), "was", "were")
    return _LACKING.format(f"{counted(len(dwells), 'planned dwell')} {were}", listed(named))


def _plateaus(acceptance: Acceptance) -> str:
    bins = {(each.bin_low_c, each.bin_high_c) for each in acceptance.judgements}
    return f"{counted(acceptance.plateaus, 'plateau')} in {counted(len(bins), 'temperature bin')}"


def _gyros(acceptance: Acceptance, verdict: str) -> str:
    names = [gyro_label(gyro) for gyro in AXES if acceptance.gyros.get(gyro) == verdict]
    return f"{listed(names)} {'is' if len(names) == 1 else 'are'}"
