"""The calibration check in report and terminal: measured biases beside the calibrated ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

from rich import box
from rich.console import Group, JustifyMethod, RenderableType
from rich.table import Table
from rich.text import Text

from gyrobench.bench.foundations.text import counted
from gyrobench.bench.navigation.positions import gyro_label, position_label
from gyrobench.bench.report.number_format import BiasScale, dph_with_sigma
from gyrobench.bench.report.page import Section, SectionTable
from gyrobench.bench.report.statements import SIGNIFICANCE
from gyrobench.bench.runs.tables.calibration_check_table import CalibrationCheckRow

_METHODS = (
    "Without a turn, the INS aligned itself and navigated. The heading after two alignments half a turn "
    "apart shows the gyro that points East; the velocity that builds up after an alignment shows the gyro "
    "that points North, by the full error model, started as the alignment leaves it. The second slope of "
    "the velocity East alone, without Schuler loop and rotation of the Earth, stands beside it. The paper "
    "names these two ways and leaves out the details, so azimuths, times, temperatures and the evaluation "
    "are chosen here."
)
_CALIBRATED = (
    "Calibrated biases are those of the same position, with straight lines between the temperatures; what a "
    "bend of the curve adds is in their uncertainty. What a bias changes from one power-on to the next is in "
    "no uncertainty here: after another power-on a difference of that size is no fault of the calibration."
)
_UNKNOWN_ACCELEROMETERS = (
    "For {} of {} biases the calibration does not tell the bias of the accelerometer along the gyro. At rest "
    "nothing tells the one from the other: at middle latitudes 100 µg pass for 0.0009 deg/h. The "
    "uncertainties hold {:.0f} µg, which is why they are large."
)
_LARGE_ACCELEROMETER_UG = 100.0
_NOTHING = "No bias could be compared with a calibrated one."


@dataclass(frozen=True)
class VerificationLine:
    """A row as text: where, how, temperature, biases, and the difference in standard uncertainties."""

    position: str
    gyro: str
    method: str
    temperature_c: str
    bias: str
    slope: str
    calibrated: str
    difference: str


def verification_section(rows: Sequence[CalibrationCheckRow]) -> Section | None:
    """Set the biases of a verification beside the calibrated ones; None without any."""
    if not rows:
        return None
    has_calibrated = any(not math.isnan(row.calibrated_dph) for row in rows)
    paragraphs = [
        verification_sentence(rows),
        _METHODS,
        _CALIBRATED if has_calibrated else "",
        accelerometer_sentence(rows),
    ]
    return Section(
        "Verification of the calibration",
        [text for text in paragraphs if text],
        tables=[_bias_table(rows), *_flag_tables(rows)],
    )


def verification_sentence(rows: Sequence[CalibrationCheckRow]) -> str:
    """Say how many biases agree with the calibration, and where the largest difference is."""
    compared = [row for row in rows if row.is_compared]
    flagged = sum(bool(row.flags) for row in rows)
    alone = len(rows) - len(compared) - flagged
    left_out = [
        f"{alone} without a calibrated bias near in position and temperature" if alone else "",
        f"{flagged} with flags" if flagged else "",
    ]
    what = ", ".join(text for text in left_out if text)
    return (_agreement(compared) if compared else _NOTHING) + (f" Not compared: {what}." if what else "")


def accelerometer_sentence(rows: Sequence[CalibrationCheckRow]) -> str:
    """Say what not knowing the accelerometers does; empty where they are known."""
    sigmas_ug = [row.accelerometer_sigma_ug for row in rows if not row.flags]
    large = [sigma for sigma in sigmas_ug if sigma > _LARGE_ACCELEROMETER_UG]
    return _UNKNOWN_ACCELEROMETERS.format(len(large), len(sigmas_ug), max(large)) if large else ""


def verification_scale(rows: Sequence[CalibrationCheckRow]) -> BiasScale:
    """Choose unit and decimals for the biases of a verification."""
    return BiasScale.of(
        [bias for row in rows for bias in (row.bias_dph, row.paper_bias_dph, row.calibrated_dph)],
        [sigma for row in rows for sigma in (row.sigma_dph, row.calibrated_sigma_dph)],
    )


def verification_lines(rows: Sequence[CalibrationCheckRow]) -> list[VerificationLine]:
    """Rows as text; a star marks a difference that chance does not explain."""
    scale = verification_scale(rows)
    differing = _differing(rows)
    return [
        VerificationLine(
            position=place_label(row),
            gyro=row.gyro.upper(),
            method=row.method,
            temperature_c="" if math.isnan(row.temperature_c) else f"{row.temperature_c:.1f}",
            bias=_with_sigma(scale, row.bias_dph, row.sigma_dph),
            slope=_with_sigma(scale, row.paper_bias_dph, row.paper_sigma_dph),
            calibrated=_with_sigma(scale, row.calibrated_dph, row.calibrated_sigma_dph),
            difference=_difference(row, row in differing),
        )
        for row in rows
    ]


def place_label(row: CalibrationCheckRow) -> str:
    """Name position and azimuth, both azimuths of a pair of alignments: "Z-Up 180°", "Z-Up 0/180°"."""
    azimuths_deg = [row.azimuth_deg]
    if row.turned_dwell is not None:
        azimuths_deg.append((row.azimuth_deg + 180.0) % 360.0)
    return f"{position_label(row.position)} {'/'.join(f'{azimuth:g}' for azimuth in azimuths_deg)}°"


def dwells_text(rows: Sequence[CalibrationCheckRow]) -> str:
    """Say how many dwells a verification took: "12 dwells for verification"."""
    numbers = {row.dwell for row in rows} | {row.turned_dwell for row in rows if row.turned_dwell}
    return f"{counted(len(numbers), 'dwell')} for verification"


def flag_lines(rows: Sequence[CalibrationCheckRow]) -> list[tuple[str, str]]:
    """Where something was wrong, and what."""
    return [
        (
            f"dwell {row.dwell}, {position_label(row.position)} at {row.azimuth_deg:g} deg, "
            f"{gyro_label(row.gyro)} by {row.method}",
            row.flags,
        )
        for row in rows
        if row.flags
    ]


def _agreement(compared: Sequence[CalibrationCheckRow]) -> str:
    count, different = len(compared), len(_differing(compared))
    allowing = f"allowing for {count} comparisons" if count > 1 else "one comparison"
    if different:
        verb = "differs" if different == 1 else "differ"
        which = f"{different} of {count} biases {verb}" if count > 1 else "The bias differs"
        found = f"{which} from the calibration (p < {SIGNIFICANCE:g}, {allowing})."
    else:
        which = f"All {count} biases agree" if count > 1 else "The bias agrees"
        found = f"{which} with the calibration (no p < {SIGNIFICANCE:g}, {allowing})."
    worst = max(compared, key=lambda row: abs(row.difference_dph))
    return (
        f"{found} The largest difference, measured less calibrated, is "
        f"{dph_with_sigma(worst.difference_dph, worst.difference_sigma_dph)} "
        f"({_sigmas(worst):+z.1f} standard uncertainties): {gyro_label(worst.gyro)} in "
        f"{place_label(worst)} at {worst.temperature_c:.0f} °C, by {worst.method}."
    )


def _differing(rows: Sequence[CalibrationCheckRow]) -> list[CalibrationCheckRow]:
    """Rows whose difference chance does not explain, allowing for the number of comparisons (Bonferroni)."""
    compared = [row for row in rows if row.is_compared]
    return [row for row in compared if row.p_value < SIGNIFICANCE / len(compared)]


def _sigmas(row: CalibrationCheckRow) -> float:
    return row.difference_dph / row.difference_sigma_dph


def _difference(row: CalibrationCheckRow, differs: bool) -> str:
    if row.flags:
        return "flagged"
    return f"{_sigmas(row):+z.1f}{'*' if differs else ''}" if row.is_compared else ""


def _with_sigma(scale: BiasScale, bias_dph: float, sigma_dph: float) -> str:
    return "" if math.isnan(bias_dph) else scale.with_sigma(bias_dph, sigma_dph)


def _bias_table(rows: Sequence[CalibrationCheckRow]) -> SectionTable:
    return SectionTable(
        f"Biases ± standard uncertainty in {verification_scale(rows).unit}. Difference: measured less "
        "calibrated in standard uncertainties of both; * chance does not explain it",
        [
            "position",
            "gyro",
            "seen in",
            "gyro / °C",
            "bias",
            "by the slope",
            "calibrated",
            "difference / σ",
        ],
        [astuple(line) for line in verification_lines(rows)],
        words=3,
    )


def _flag_tables(rows: Sequence[CalibrationCheckRow]) -> list[SectionTable]:
    lines = flag_lines(rows)
    return [SectionTable("Flagged", ["where", "what was wrong"], lines, words=2)] if lines else []


_HEADERS = ("position", "gyro", "seen in", "°C", "bias", "slope", "calibrated", "diff")
_WORDS = 3
_LEGEND = (
    "slope: by the second slope of the velocity East alone. diff: bias less calibrated one in standard "
    "uncertainties of both; * chance does not explain it. Changes from power-on to power-on are in no "
    "uncertainty."
)


def verification_table(rows: Sequence[CalibrationCheckRow]) -> RenderableType:
    """Biases that a verification shows beside the calibrated ones, and what that says."""
    if not rows:
        return Text("Nothing was verified.")
    # Not the table's title: rich would fold that to the width of the table.
    unit = verification_scale(rows).unit
    heading = Text(f"Verification: bias ± 1 sigma in {unit} by gyro temperature, °C", style="bold")
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=0)
    for number, header in enumerate(_HEADERS):
        is_word = number < _WORDS
        justify: JustifyMethod = "left" if is_word else "right"
        table.add_column(header, justify=justify, no_wrap=is_word, min_width=len(header))
    for line in verification_lines(rows):
        table.add_row(*(Text(cell.replace(" ± ", " ±")) for cell in astuple(line)))
    flags = [f"{where}: {what}" for where, what in flag_lines(rows)]
    sentences = [verification_sentence(rows), accelerometer_sentence(rows), *flags, _LEGEND]
    return Group(heading, table, *(Text(one) for one in sentences if one))
