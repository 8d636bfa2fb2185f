"""A search for effects in tables, the same on the page and in the terminal."""

from __future__ import annotations

from gyrobench.bench.closure.loop import Closure
from gyrobench.bench.foundations.text import listed, probability_number
from gyrobench.bench.report.closure.closure_text import (
    cycles_text,
    is_noise_only,
    labels,
    scale_of_errors,
    share_text,
)
from gyrobench.bench.report.number_format import odds_text, p_text

#: What a composed law is.
COMPOSED = (
    "Laws composed from the grammar of effects, fitted beside the effects found. They are empirical: "
    "hypotheses from the data that they explain, until cycles of other runs confirm them."
)


def rotation_table(closure: Closure) -> tuple[list[str], list[list[str]]]:
    """Head and rows of a rotation; three columns of words, then errors."""
    scale = scale_of_errors(closure)
    rows = [
        [
            cycles_text(closure, [turn.cycle]),
            turn.verdict or f"not possible: {turn.reason}",
            labels(closure, turn.effects) or ("none" if turn.verdict else ""),
            *(
                scale.text(value) if turn.verdict else ""
                for value in (turn.error_before_dph, turn.error_after_dph, turn.noise_dph)
            ),
        ]
        for turn in closure.rotation
    ]
    return ["held out", "verdict", "effects", "before", "after", "noise"], rows


def gains_text(gains: dict[int, float]) -> str:
    """Share of chi2 explained in each cycle left out: "1: 97 %, 2: 96 %"."""
    return ", ".join(f"{cycle}: {share_text(gain)}" for cycle, gain in gains.items())


def effect_table(closure: Closure) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the effects found; four columns of words, then size and probability."""
    scale = scale_of_errors(closure)
    rows = [
        [
            each.effect.display_name,
            listed(each.axes),
            labels(closure, each.tied_with) or "none",
            gains_text(each.gains) or "no",
            scale.with_sigma(each.rms_dph, each.rms_sigma_dph),
            probability_number(each.probability),
        ]
        for each in closure.effects
    ]
    shown = "coefficients" if closure.quantity.axes[0][1:] else f"{closure.quantity.sensor}s"
    return ["effect", shown, "tied with", "cross-validated", "size", "P"], rows


def evidence_table(closure: Closure) -> tuple[list[str], list[list[str]]]:
    """Head and rows of each candidate alone, without columns that would be empty."""
    found = {each.effect.name for each in closure.effects}
    tied = {name for each in closure.effects for name in each.tied_with}
    head = ["effect", "", "p"] if is_noise_only(closure) else ["effect", "", "share", "p"]
    head += ["odds"] if closure.effects else []
    rows = []
    for each in closure.evidence:
        if each.missing_input is None:
            name = each.effect.name
            cells = {
                "effect": each.effect.display_name,
                "": "found" if name in found else "tied" if name in tied else "",
                "share": share_text(each.share),
                "p": p_text(each.p_value),
                "odds": odds_text(each.log_odds_against) if each.log_odds_against > 0.0 else "",
            }
            rows.append([cells[column] for column in head])
    return head, rows


def evidence_caption(closure: Closure) -> str:
    """Explanation of the columns of :func:`evidence_table`."""
    share = "" if is_noise_only(closure) else "share: share of excess variance explained; "
    odds = "; odds: of the effects found to this one" if closure.effects else ""
    return f"Each effect alone. {share}p: corrected for all candidate fits{odds}"


def composed_table(closure: Closure) -> tuple[list[str], list[list[str]]]:
    """Composed laws, most probable first, and what no law describes: header and rows."""
    scale, composed = scale_of_errors(closure), closure.composed
    if composed is None:
        return [], []
    rows = [
        [
            law.follows,
            law.file.shape,
            law.file.memory,
            f"{law.probability:.2f}",
            scale.text(law.error_after_dph),
        ]
        for law in composed.laws
    ]
    rows.append(["no law of the grammar, or one and something else", "", "", f"{composed.other:.2f}", ""])
    rows.append(["of this: a law and something else", "", "", f"{composed.law_and_remainder:.2f}", ""])
    return [
        f"{closure.quantity.label} follows",
        "shape",
        "memory",
        "P",
        f"held-out error, {scale.unit}",
    ], rows
