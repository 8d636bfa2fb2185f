"""The chain from residual to cause as parts of a report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gyrobench.bench.closure.loop import Closure, whereabouts
from gyrobench.bench.foundations.text import plain_name
from gyrobench.bench.navigation.positions import AXES, gyro_label
from gyrobench.bench.report.closure import wording
from gyrobench.bench.report.closure.effect_figure import closure_effect_figure
from gyrobench.bench.report.closure.error_figure import closure_error_figure
from gyrobench.bench.report.closure.evidence_figure import closure_evidence_figure
from gyrobench.bench.report.closure.residual_figure import closure_residual_figure
from gyrobench.bench.report.closure.residuals import (
    noise_dph,
    residuals_dph,
    rests_on_noise,
    rms,
    scale_of_errors,
)
from gyrobench.bench.report.closure.rows import effect_table, evidence_table, tried_caption
from gyrobench.bench.report.number_format import p_text
from gyrobench.bench.report.page import Section, SectionFigure, SectionTable

_RESIDUALS = (
    "{}: measured minus predicted bias. Each point is a dwell, hollow ones the search did not see; the grey "
    "band is one standard deviation of the noise on either side. {}"
)
_BOTH_SIDES = "Above by the declared model, below with the effects found."
_EFFECT = (
    "{}: what is left of the bias when all of the model but this effect's main term is taken away, against "
    "what that term follows. The line is the term as fitted to the filled points; hollow ones had no say."
)
_EVIDENCE = (
    "Share of the sum of squares beyond the noise that each effect takes away by itself. Effects that go "
    "together in this campaign take away the same, so a long bar alone proves nothing."
)
_CHANCE = (
    "Each effect by itself against chance: the declared model leaves no more than noise as a whole, so there "
    "are no shares to tell."
)
_ERRORS = "Rms of measured minus predicted bias in the cycles held out; the black lines are its noise."
_UNEXPLAINED = (
    "The model is not to be trusted beyond that size: what is left comes from something that is not among "
    "the effects tried, or from an input that was not measured."
)


def closure_sections(closure: Closure) -> list[Section]:
    """Everything that a search found, in the order of the argument."""
    sections = [_before(closure), _cause(closure), _tried(closure), _error(closure), _after(closure)]
    return [section for section in sections if section]


def _before(closure: Closure) -> Section:
    caption = _BOTH_SIDES if closure.effects else ""
    figures = [
        SectionFigure(
            f"residuals_{gyro}",
            _RESIDUALS.format(gyro_label(gyro), caption).strip(),
            closure_residual_figure(closure, gyro),
        )
        for gyro in AXES
    ]
    return Section(
        "What the declared model leaves",
        _told(wording.before_sentence(closure), wording.scale_sentence(closure)),
        figures,
    )


def _cause(closure: Closure) -> Section | None:
    if not closure.effects:
        return None
    figures = []
    for each in closure.effects:
        name = each.candidate.effect.name
        caption = _EFFECT.format(plain_name(name).capitalize())
        figures.append(SectionFigure(f"effect_{name}", caption, closure_effect_figure(closure, each)))
    effects = SectionTable(
        f"Size: rms in the dwells searched, without its mean, in {scale_of_errors(closure).unit}. Confirmed: "
        "share of the squares that it takes away in each cycle left out, its size taken from the others",
        *effect_table(closure),
        words=4,
    )
    return Section("The cause", wording.cause_sentences(closure), figures, [effects, _sizes(closure)])


def _sizes(closure: Closure) -> SectionTable:
    scale = scale_of_errors(closure)
    rows = [
        [plain_name(each.candidate.effect.name), term, *map(_size, scale.factor * sizes_dph)]
        for each in closure.effects
        for term, sizes_dph in zip(each.candidate.form.terms, each.sizes_dph.T, strict=True)
    ]
    return SectionTable(
        f"Size of each term in {scale.unit} for one unit of what it follows; empty: the gyro does without",
        ["effect", "follows", *(gyro_label(gyro) for gyro in AXES)],
        rows,
        words=2,
    )


def _size(value: float) -> str:
    return f"{value:.4g}" if value else ""


def _tried(closure: Closure) -> Section:
    drawn = not rests_on_noise(closure) or bool(closure.effects)
    caption = _CHANCE if rests_on_noise(closure) else _EVIDENCE
    figures = [SectionFigure("evidence", caption, closure_evidence_figure(closure))] if drawn else []
    table = SectionTable(tried_caption(closure), *evidence_table(closure), words=2)
    paragraphs = [wording.runner_up_sentence(closure), *wording.tie_sentences(closure)]
    paragraphs += wording.lacks_sentences(closure)
    paragraphs += [wording.limit_sentence(closure)] if closure.verdict == "clean" else []
    title = "What else was tried, and what else it could be" if closure.effects else "What was tried"
    return Section(title, _told(*paragraphs), figures, [table])


def _error(closure: Closure) -> Section:
    held_out, scale = ~closure.searched, scale_of_errors(closure)
    names = ["declared model", "with the effects found"] if closure.effects else ["declared model"]
    models = [closure.declared, closure.model][: len(names)]
    rows = [
        [name, *(scale.text(value) for value in _rms_by_gyro(residuals_dph(closure, model)[held_out]))]
        for name, model in zip(names, models, strict=True)
    ]
    rows.append(["noise", *(scale.text(value) for value in _rms_by_gyro(noise_dph(closure)[held_out]))])
    table = SectionTable(
        f"Rms of measured minus predicted bias in the cycles held out, in {scale.unit}",
        ["", *(gyro_label(gyro) for gyro in AXES), "all"],
        rows,
    )
    return Section(
        "Error on data that the search did not see",
        _told(wording.error_sentence(closure), wording.constants_sentence(closure)),
        [SectionFigure("errors", _ERRORS, closure_error_figure(closure))],
        [table],
    )


def _rms_by_gyro(values_dph: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> list[float]:
    return [*(rms(column) for column in values_dph.T), rms(values_dph)]


def _after(closure: Closure) -> Section:
    before, after = closure.before, closure.after
    tests = [("sum of squares against the noise", before.p_noise, after.p_noise)]
    tests += [
        (f"follows {name}", before.p_structure[name], after.p_structure.get(name, np.nan))
        for name in before.p_structure
    ]
    table = SectionTable(
        "Tests of what is left in the dwells searched: probability of at least as much by chance, before the "
        "number of tests is allowed for",
        ["test", "declared model", "with the effects found"],
        [(name, p_text(one), p_text(other)) for name, one, other in tests],
    )
    if not closure.effects:
        table = SectionTable(table.caption, table.header[:2], [row[:2] for row in table.rows])
    extra = "" if whereabouts(closure) is None else _UNEXPLAINED
    return Section("What is left", _told(wording.after_sentence(closure), extra), tables=[table])


def _told(*paragraphs: str) -> Sequence[str]:
    return [text for text in paragraphs if text]
