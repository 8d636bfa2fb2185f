"""Rows of the tables about a search for effects, as text; an empty cell says nothing."""

from __future__ import annotations

from gyrobench.bench.closure.loop import Closure
from gyrobench.bench.foundations.text import listed, plain_name
from gyrobench.bench.report.closure.residuals import rests_on_noise, scale_of_errors
from gyrobench.bench.report.closure.wording import gains_text, odds_text, share_text
from gyrobench.bench.report.number_format import p_text


def effect_table(closure: Closure) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the effects found; four columns of words, then size and p."""
    scale = scale_of_errors(closure)
    head = ["effect", "gyros", "tied with", "confirmed in cycle", "size", "p"]
    rows = [
        [
            plain_name(each.candidate.effect.name),
            listed(each.axes),
            listed([plain_name(name) for name in each.tied_with]) or "nothing",
            gains_text(each.gains) or "none",
            scale.text(each.rms_dph),
            p_text(each.p_value),
        ]
        for each in closure.effects
    ]
    return head, rows


def evidence_table(closure: Closure) -> tuple[list[str], list[list[str]]]:
    """Head and rows of each effect tried by itself; columns that would be empty are left out.

    Without effects found there are no odds against them; where the declared model leaves no more
    than noise there are no shares.
    """
    found = {each.candidate.effect.name for each in closure.effects}
    tied = {name for each in closure.effects for name in each.tied_with}
    head = ["effect"]
    head += ["", "share"] if not rests_on_noise(closure) else [""]
    head += ["p", "odds"] if closure.effects else ["p"]
    rows = []
    for each in closure.evidence:
        if each.lacks is None:
            name = each.effect.name
            cells = {
                "effect": plain_name(name),
                "": "found" if name in found else "tied" if name in tied else "",
                "share": share_text(each.share),
                "p": p_text(each.p_value),
                "odds": odds_text(each.score_behind) if each.score_behind > 0.0 else "",
            }
            rows.append([cells[column] for column in head])
    return head, rows


def tried_caption(closure: Closure) -> str:
    """Explain the columns of :func:`evidence_table`."""
    share = "" if rests_on_noise(closure) else "share: of the squares beyond the noise; "
    odds = (
        "; odds: by how much the data prefer what was found, all of it together, to this effect alone"
        if closure.effects
        else ""
    )
    return f"Each effect by itself. {share}p: of as much by chance, over all that was tried{odds}"
