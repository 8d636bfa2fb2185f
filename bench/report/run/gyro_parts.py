"""What the report says of each gyro: its bins and the comparison of positions, cell by cell."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from gyrobench.bench.bias.bins import BiasBin, PositionComparison, compare_positions, paper_bins
from gyrobench.bench.foundations.text import bin_label
from gyrobench.bench.navigation.positions import POSITIONS, gyro_label, position_label
from gyrobench.bench.report.findings import agreement_sentence, differing, equality_sentence, scatter_sentence
from gyrobench.bench.report.wording import BiasScale, bins_by_temperature, p_text, scale_of_bins


@dataclass(frozen=True)
class ComparisonText:
    """How the positions compare in a bin by one estimator: largest difference, and between which."""

    p_value: str
    difference: str
    pair: str
    differs: bool


@dataclass(frozen=True)
class BinRow:
    """A temperature bin of one gyro as text: a cell for each position, and what their comparison shows.

    Bins in a row that are empty in all positions make one row without cells; without the paper's
    method there are no cells of it.
    """

    label: str
    cells: list[str]
    paper_cells: list[str]
    comparison: ComparisonText | None
    paper_comparison: ComparisonText | None
    temperature_spread: str

    @property
    def differs(self) -> bool:
        """Whether the positions differ by the state-space estimator."""
        return self.comparison is not None and self.comparison.differs

    @property
    def verdict(self) -> str:
        """Say which estimators find that the positions differ."""
        by_paper = self.paper_comparison is not None and self.paper_comparison.differs
        if self.paper_comparison is None or not (self.differs or by_paper):
            return "differs" if self.differs else ""
        if self.differs:
            return "differs by both" if by_paper else "differs, by the paper's not"
        return "only by the paper's"


@dataclass(frozen=True)
class GyroPart:
    """What the report says of one gyro."""

    label: str
    name: str
    unit: str
    sentence: str
    agreement: str
    scatter: str
    rows: list[BinRow]


def measured_positions(bins: Iterable[BiasBin]) -> list[str]:
    """Positions that have bins, in the order of the paper."""
    measured = {each.position for each in bins}
    return [name for name in POSITIONS if name in measured]


def gyro_part(gyro: str, bins: Sequence[BiasBin]) -> GyroPart:
    """Put the bins of one gyro into words and tables.

    Parameters
    ----------
    gyro : {"x", "y", "z"}
        Which gyro.
    bins : sequence of BiasBin
        Of all gyros: each has a column for every position measured.
    """
    own = [each for each in bins if each.gyro == gyro]
    by_paper = paper_bins(own)
    scale = scale_of_bins([*own, *by_paper])
    comparisons, paper_comparisons = compare_positions(own), compare_positions(by_paper)
    texts, paper_texts = _comparison_texts(comparisons, scale), _comparison_texts(paper_comparisons, scale)
    spreads = {each.bin_low_c: f"{each.temperature_spread_c:.1f}" for each in comparisons}
    positions = measured_positions(bins)
    rows = [
        BinRow(
            bin_label(low, high),
            _cells(members, positions, scale, with_count=True),
            _cells(paper_bins(members), positions, scale, with_count=False),
            texts.get(low),
            paper_texts.get(low),
            spreads.get(low, ""),
        )
        for low, high, members in bins_by_temperature(own)
    ]
    return GyroPart(
        gyro_label(gyro),
        gyro,
        scale.unit,
        equality_sentence(comparisons),
        agreement_sentence(comparisons, paper_comparisons),
        scatter_sentence(own),
        rows,
    )


def _comparison_texts(
    comparisons: Sequence[PositionComparison], scale: BiasScale
) -> dict[float, ComparisonText]:
    """Comparisons by the lower end of their bin."""
    different = differing(comparisons)
    return {
        each.bin_low_c: ComparisonText(
            p_text(each.p_value),
            scale.with_sigma(each.largest_difference_dph, each.largest_difference_sigma_dph),
            " above ".join(map(position_label, each.largest_pair)),
            each in different,
        )
        for each in comparisons
    }


def _cells(
    members: Iterable[BiasBin], positions: Iterable[str], scale: BiasScale, *, with_count: bool
) -> list[str]:
    """Texts of the positions of one bin; none where all are empty."""
    texts = {
        each.position: scale.with_sigma(each.bias_dph, each.sigma_dph)
        + (f" ({each.count})" if with_count else "")
        for each in members
        if not each.is_empty
    }
    return [texts.get(position, "empty") for position in positions] if texts else []
