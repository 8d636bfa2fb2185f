"""What is said of a batch, the same on its page and in the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from gyrobench.bench.fleet.batch_model import FALSE_ALARM, EffectSize, TraitInBatch, UnitInBatch, standing_out
from gyrobench.bench.foundations.text import counted, listed
from gyrobench.bench.report.number_format import BiasScale, dph_with_sigma, p_text
from gyrobench.bench.runs.index_run_biases import LEVEL

OUT_HEADER = ("unit", "runs", "in", "its value", "others lead to", "p all")
SPREAD_HEADER = ("quantity", "units", "mean", "between units", "95 %", "between runs")


def batch_sentence(batch: Sequence[TraitInBatch]) -> str:
    """Say which units stand out."""
    comparisons = sum(len(trait.units) for trait in batch)
    allowing = f"p < {FALSE_ALARM:g}, allowing for {counted(comparisons, 'comparison')}"
    out = standing_out(batch)
    if not out:
        return f"No unit stands out ({allowing})."
    texts = []
    for name in dict.fromkeys(unit.unit for _, unit in out):
        mine = [(trait, unit) for trait, unit in out if unit.unit == name]
        trait, unit = mine[0]
        difference = unit.bias_dph - unit.expected_dph
        others = len(mine) - 1
        more = f", and in {others} other {'quantity' if others == 1 else 'quantities'}" if others else ""
        beyond = dph_with_sigma(difference, unit.expected_sigma_dph)
        texts.append(
            f"unit {name} in {trait.trait.label} ({beyond} beside what the others lead to expect){more}"
        )
    sentence = listed(texts)
    verb = "stands out" if len(texts) == 1 else "stand out"
    return f"{counted(len(texts), 'unit').capitalize()} {verb}: {sentence} ({allowing})."


def out_rows(batch: Sequence[TraitInBatch]) -> list[list[str]]:
    """One row for each quantity in which a unit stands out; see :data:`OUT_HEADER`."""
    scale = batch_scale(batch)
    return [
        [
            unit.unit,
            str(unit.runs),
            trait.trait.label,
            scale.with_sigma(unit.bias_dph, unit.sigma_dph, "±"),
            scale.with_sigma(unit.expected_dph, unit.expected_sigma_dph, "±"),
            p_text(unit.p_adjusted),
        ]
        for trait, unit in standing_out(batch)
    ]


def spread_rows(batch: Sequence[TraitInBatch]) -> list[list[str]]:
    """One row for each quantity; see :data:`SPREAD_HEADER`."""
    scale = batch_scale(batch)
    rows = []
    for trait in batch:
        spread = trait.between_units
        between_runs = "" if trait.between_runs_dph is None else scale.text(trait.between_runs_dph)
        rows.append(
            [
                trait.trait.label,
                str(len(trait.units)),
                scale.with_sigma(trait.mean_dph, trait.mean_sigma_dph, "±"),
                scale.text(spread.value),
                f"{scale.text(spread.low)}..{scale.text(spread.high)}",
                between_runs,
            ]
        )
    return rows


def unit_rows(trait: TraitInBatch) -> list[list[str]]:
    """One row for each unit in one quantity: measured, shrunken, p."""
    scale = batch_scale([trait])
    return [
        [
            unit.unit,
            str(unit.runs),
            scale.with_sigma(unit.bias_dph, unit.sigma_dph),
            scale.with_sigma(unit.shrunken_dph, unit.shrunken_sigma_dph),
            p_text(unit.p_value),
            p_text(unit.p_adjusted),
        ]
        for unit in trait.units
    ]


def batch_scale(batch: Sequence[TraitInBatch]) -> BiasScale:
    """Choose the unit and the number of decimals for a batch."""
    units: list[UnitInBatch] = [unit for trait in batch for unit in trait.units]
    return BiasScale.of(
        [unit.bias_dph for unit in units], [trait.mean_sigma_dph for trait in batch if trait.mean_sigma_dph]
    )


def levels(batch: Sequence[TraitInBatch]) -> list[TraitInBatch]:
    """Those of a batch's quantities that are levels of gyros, and sizes of effects."""
    return [trait for trait in batch if isinstance(trait.trait, EffectSize) or trait.trait.name == LEVEL]
