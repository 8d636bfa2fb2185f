"""The tables of a run's page, as text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from gyrobench.bench.foundations.text import bin_label
from gyrobench.bench.live.picture_parts import BenchNow, DwellDone, FillingBin, mean_known
from gyrobench.bench.monitor.headline import celsius
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.report.number_format import BiasScale, by_temperature, true_minus


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
class ShownDwell:
    """A dwell as text, with a cell for each gyro; flagged dwells are in no bin."""

    number: int
    cycle: int
    position: str
    temperature: str
    cells: tuple[Cell, ...]
    flags: str


@dataclass(frozen=True)
class ShownDwells:
    """Dwells, the newest first, and the unit of their biases."""

    unit: str
    rows: tuple[ShownDwell, ...]


def bin_tables(bins: Iterable[FillingBin]) -> list[BinTable]:
    """Bins by gyro, the warmest first; none as long as all are empty."""
    known = list(bins)
    filled = [each for each in known if each.count]
    if not filled:
        return []
    scale = BiasScale.of([each.bias_dph for each in filled], [each.sigma_dph for each in filled])
    return [_bin_table(gyro, [each for each in known if each.gyro == gyro], scale) for gyro in AXES]


def shown_dwells(dwells: Sequence[DwellDone]) -> ShownDwells:
    """Dwells, the newest first."""
    biases = [value for dwell in dwells for value in dwell.bias_dph]
    scale = BiasScale.of(biases, [value for dwell in dwells for value in dwell.sigma_dph])
    return ShownDwells(scale.unit, tuple(_shown_dwell(dwell, scale) for dwell in reversed(dwells)))


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
    ranges = by_temperature(bins, lambda each: (each.low_c, each.high_c), lambda each: each.count > 0)
    filled = [number for number, (_, _, members) in enumerate(ranges) if members]
    shown = ranges[filled[0] : filled[-1] + 1] if filled else []
    return BinTable(
        gyro=gyro_label(gyro),
        unit=scale.unit,
        positions=tuple(position_label(position) for position in positions),
        rows=tuple(
            (true_minus(bin_label(low_c, high_c, "…")), _bin_cells(members, positions, scale))
            for low_c, high_c, members in reversed(shown)
        ),
    )


def _bin_cells(members: list[FillingBin], positions: list[str], scale: BiasScale) -> tuple[Cell, ...]:
    """A cell for each position; none for a range that is empty in all of them."""
    by_position = {each.position: each for each in members}
    return tuple(_bin_cell(by_position.get(position), scale) for position in positions) if members else ()


def _bin_cell(each: FillingBin | None, scale: BiasScale) -> Cell:
    if each is None or not each.count:
        return Cell()
    return _cell(each.bias_dph, each.sigma_dph, scale, each.count)


def _cell(bias_dph: float, sigma_dph: float, scale: BiasScale, count: int = 1) -> Cell:
    if not (math.isfinite(bias_dph) and math.isfinite(sigma_dph)):
        return Cell()
    return Cell(true_minus(scale.text(bias_dph)), scale.text(sigma_dph), count)


def _shown_dwell(dwell: DwellDone, scale: BiasScale) -> ShownDwell:
    pairs = zip(dwell.bias_dph, dwell.sigma_dph, strict=True)
    gyro_c = mean_known(dwell.gyro_c)
    return ShownDwell(
        number=dwell.number,
        cycle=dwell.cycle,
        position=position_label(dwell.position),
        temperature="" if math.isnan(gyro_c) else true_minus(f"{gyro_c:z.1f}"),
        cells=tuple(_cell(bias, sigma, scale) for bias, sigma in pairs),
        flags=dwell.flags,
    )


def _set_point(temperature_c: float) -> str:
    return "not controlled" if math.isnan(temperature_c) else celsius(temperature_c, 2)


def _triple(values_c: Iterable[float]) -> str:
    values = list(values_c)
    if all(math.isnan(value) for value in values):
        return "not known"
    return true_minus(", ".join("–" if math.isnan(value) else f"{value:z.2f}" for value in values)) + " °C"


def _axis(angle_deg: float, rate_dps: float) -> str:
    if math.isnan(angle_deg):
        return "not known"
    rate = "" if math.isnan(rate_dps) else f", {rate_dps:z.2f} deg/s"
    return true_minus(f"{angle_deg:z.3f}°{rate}")


def _age(age_s: float) -> str:
    return "never" if math.isnan(age_s) else f"{age_s:.1f} s"
