"""The tables of a run's page, as text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bench.live.picture import BenchNow, DwellDone, FillingBin
from bench.monitor.headline import celsius
from bench.navigation.positions import AXES, POSITIONS
from bench.report.wording import BiasScale, bin_label, gyro_label, position_label


@dataclass(frozen=True)
class Cell:
    """A bias and its standard uncertainty; ``count`` dwells stand behind it. Empty text for nothing."""

    bias: str = ""
    sigma: str = ""
    count: int = 0


@dataclass(frozen=True)
class BinTable:
    """Bins of one gyro: their ranges with a cell for each position. No cells: a range that is empty."""

    gyro: str
    unit: str
    positions: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]


@dataclass(frozen=True)
class DwellRow:
    """A dwell as text, with a cell for each gyro; flagged dwells are in no bin."""

    number: int
    cycle: int
    position: str
    temperature: str
    cells: tuple[Cell, ...]
    flags: str


@dataclass(frozen=True)
class DwellTable:
    """Dwells, the newest first, and the unit of their biases."""

    unit: str
    rows: tuple[DwellRow, ...]


def bin_tables(bins: Iterable[FillingBin]) -> list[BinTable]:
    """Bins by gyro, the warmest first; none as long as all are empty."""
    known = list(bins)
    filled = [each for each in known if each.count]
    if not filled:
        return []
    scale = BiasScale.of([each.bias_dph for each in filled], [each.sigma_dph for each in filled])
    return [_bin_table(gyro, [each for each in known if each.gyro == gyro], scale) for gyro in AXES]


def dwell_table(dwells: Sequence[DwellDone]) -> DwellTable:
    """Dwells, the newest first."""
    biases = [value for dwell in dwells for value in dwell.bias_dph]
    scale = BiasScale.of(biases, [value for dwell in dwells for value in dwell.sigma_dph])
    return DwellTable(scale.unit, tuple(_dwell_row(dwell, scale) for dwell in reversed(dwells)))


def reading_rows(bench: BenchNow) -> list[tuple[str, str, str]]:
    """Present readings: what, value, and how old the instrument's last answer is."""
    chamber, table, ins = (_age(age_s) for age_s in (bench.chamber_age_s, bench.table_age_s, bench.ins_age_s))
    return [
        ("chamber air", celsius(bench.chamber_c, 2), chamber),
        ("chamber set", _set_point(bench.chamber_set_c), chamber),
        ("gyro optics x, y, z", _triple(bench.gyro_c), ins),
        ("electronics x, y, z", _triple(bench.electronics_c), ins),
        ("INS case", celsius(bench.case_c, 2), ins),
        ("INS mode", bench.ins_mode, ins),
        ("table outer axis", _axis(bench.outer_deg, bench.outer_rate_dps), table),
        ("table inner axis", _axis(bench.inner_deg, bench.inner_rate_dps), table),
    ]


def _bin_table(gyro: str, bins: list[FillingBin], scale: BiasScale) -> BinTable:
    used = {each.position for each in bins}
    positions = [position for position in POSITIONS if position in used]
    by_range: dict[tuple[float, float], dict[str, FillingBin]] = {}
    for each in bins:
        by_range.setdefault((each.low_c, each.high_c), {})[each.position] = each
    rows: list[tuple[float, float, tuple[Cell, ...]]] = []
    for (low_c, high_c), members in sorted(by_range.items(), reverse=True):
        if any(each.count for each in members.values()):
            cells = tuple(_bin_cell(members.get(position), scale) for position in positions)
            rows.append((low_c, high_c, cells))
        elif rows and not rows[-1][2]:
            rows[-1] = (low_c, rows[-1][1], ())
        else:
            rows.append((low_c, high_c, ()))
    while rows and not rows[-1][2]:
        rows.pop()
    while rows and not rows[0][2]:
        rows.pop(0)
    return BinTable(
        gyro=gyro_label(gyro),
        unit=scale.unit,
        positions=tuple(position_label(position) for position in positions),
        rows=tuple((_minus(bin_label(low_c, high_c, "…")), cells) for low_c, high_c, cells in rows),
    )


def _bin_cell(each: FillingBin | None, scale: BiasScale) -> Cell:
    if each is None or not each.count:
        return Cell()
    return _cell(each.bias_dph, each.sigma_dph, scale, each.count)


def _cell(bias_dph: float, sigma_dph: float, scale: BiasScale, count: int = 1) -> Cell:
    if not (math.isfinite(bias_dph) and math.isfinite(sigma_dph)):
        return Cell()
    return Cell(_minus(scale.text(bias_dph)), scale.text(sigma_dph), count)


def _dwell_row(dwell: DwellDone, scale: BiasScale) -> DwellRow:
    pairs = zip(dwell.bias_dph, dwell.sigma_dph, strict=True)
    known = [value for value in dwell.gyro_c if not math.isnan(value)]
    return DwellRow(
        number=dwell.number,
        cycle=dwell.cycle,
        position=position_label(dwell.position),
        temperature=_minus(f"{sum(known) / len(known):z.1f}") if known else "",
        cells=tuple(_cell(bias, sigma, scale) for bias, sigma in pairs),
        flags=dwell.flags,
    )


def _set_point(temperature_c: float) -> str:
    return "not controlled" if math.isnan(temperature_c) else celsius(temperature_c, 2)


def _triple(values_c: Iterable[float]) -> str:
    values = list(values_c)
    if all(math.isnan(value) for value in values):
        return "not known"
    return _minus(", ".join("–" if math.isnan(value) else f"{value:z.2f}" for value in values)) + " °C"


def _axis(angle_deg: float, rate_dps: float) -> str:
    if math.isnan(angle_deg):
        return "not known"
    rate = "" if math.isnan(rate_dps) else f", {rate_dps:z.2f} deg/s"
    return _minus(f"{angle_deg:z.3f}°{rate}")


def _age(age_s: float) -> str:
    return "never" if math.isnan(age_s) else f"{age_s:.1f} s"


def _minus(text: str) -> str:
    """With true minus signs, which are as wide as the plus and read as numbers."""
    return text.replace("-", "−")
