"""Findings of a search for effects for the page (closure.html) and the terminal; files of a search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from gyrobench.bench.closure.files import write_closure
from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.foundations.arrays import nan_rms
from gyrobench.bench.foundations.text import counted, listed, probability_number, with_sigma
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.report import closure_text as text
from gyrobench.bench.report.figures.closure import (
    closure_effect_figure,
    closure_error_figure,
    closure_evidence_figure,
    closure_residual_figure,
)
from gyrobench.bench.report.number_format import odds_text, p_text, share_text
from gyrobench.bench.report.page import Findings, Section, SectionFigure, SectionTable, write_findings
from gyrobench.bench.report.run_report import write_report
from gyrobench.bench.runs.folder import CLOSURE, RunFolder

_RESIDUALS_CAPTION = (
    "{}: measured minus predicted {}. Each point is a dwell, hollow points are held out; the grey band is "
    "one standard deviation of the noise. {}"
)
_BOTH_MODELS_CAPTION = "Top: declared model; bottom: with the effects found."
_EFFECT_CAPTION = (
    "{}: partial residual (measured {} minus the model without this effect's main term) against what that "
    "term follows. The line is the fit to the filled points; hollow points are held out."
)
_EVIDENCE_CAPTION = (
    "Share of excess variance explained by each effect alone. Effects that are correlated in this campaign "
    "explain the same share: a long bar alone is no proof."
)
_P_VALUES_CAPTION = (
    "Significance of each effect alone. The declared model leaves no excess variance to explain."
)
_ERRORS_CAPTION = "Rms of measured minus predicted {} in the held-out cycles; the black lines are the noise."
_UNEXPLAINED_ADVICE = (
    "Do not rely on the model below that size: the effect is not among the candidates, or follows an input "
    "that was not measured."
)
_COMPOSED_TEXT = (
    "Laws composed from the grammar of effects, fitted beside the effects found. They are empirical: "
    "hypotheses from the data that they explain, until cycles of other runs confirm them."
)
#: Largest length of a folder name, characters.
_MAX_FOLDER_NAME = 100
#: Colours of the template's box, by verdict.
_COLOURS = {"clean": "finished", "explained": "finished", "ambiguous": "stopped", "unexplained": "failed"}


def closure_sections(closure: Closure) -> list[Section]:
    """All sections: residual, effects, alternatives, held-out error, each cycle held out, lack of fit."""
    builders = (
        _residual_section,
        _effects_section,
        _composed_section,
        _alternatives_section,
        _error_section,
        _held_out_in_turn_section,
        _lack_of_fit_section,
    )
    in_rows = closure.quantity.in_rows
    return [
        replace(
            section,
            paragraphs=list(map(in_rows, section.paragraphs)),
            figures=[replace(each, caption=in_rows(each.caption)) for each in section.figures],
            tables=[replace(each, caption=in_rows(each.caption)) for each in section.tables],
        )
        for build in builders
        if (section := build(closure))
    ]


def _residual_section(closure: Closure) -> Section:
    caption = _BOTH_MODELS_CAPTION if closure.effects else ""
    figures = [
        SectionFigure(
            f"residuals_{gyro}",
            _RESIDUALS_CAPTION.format(heading, closure.quantity.label, caption).strip(),
            partial(closure_residual_figure, closure, gyro),
        )
        for gyro, heading in zip(AXES, closure.quantity.headings, strict=True)
    ]
    return Section(
        "Residual of the declared model",
        [
            text.declared_residual_sentence(closure),
            *closure.noise.sentences(
                closure.quantity,
                is_structureless=closure.verdict != "unexplained" or closure.differs_held_out,
            ),
            _correlation_sentence(closure),
        ],
        figures,
    )


def _correlation_sentence(closure: Closure) -> str:
    """Gyros with correlated residuals, which may pass for an effect; else empty."""
    if closure.verdict == "clean" or closure.after.correlated is None:
        return ""
    *sensors, value = closure.after.correlated
    headings = closure.quantity.place([closure.quantity.axes[each] for each in sensors])
    sentence = f"The remaining residuals of the {headings} are correlated ({value:+.2f})."
    if (factor := closure.noise.correlation_factor) > 1.0:
        return (
            f"{sentence} In p-values and probabilities, {factor:.1f} values of the three gyros count as one."
        )
    return (
        f"{sentence} If that is noise, it counts once for each, and looks like an effect more often than the "
        "p-values state."
    )


def _effects_section(closure: Closure) -> Section | None:
    if not closure.effects:
        return None
    figures = []
    for each in closure.effects:
        caption = _EFFECT_CAPTION.format(each.effect.display_name.capitalize(), closure.quantity.label)
        caption = f"{caption} {each.candidate.form.weights_note}".strip()
        figures.append(
            SectionFigure(
                f"effect_{each.effect.name}", caption, partial(closure_effect_figure, closure, each)
            )
        )
    title = "Effect" if len(closure.effects) == 1 else "Effects"
    return Section(
        title,
        text.effect_sentences(closure),
        figures,
        [effect_table(closure), _sizes_table(closure), *_parameter_tables(closure)],
    )


def effect_table(closure: Closure) -> SectionTable:
    """Table of the effects found."""
    scale = text.scale_of_errors(closure)
    rows = [
        [
            each.effect.display_name,
            listed(each.axes),
            text.labels(closure, each.tied_with) or "none",
            ", ".join(f"{cycle}: {share_text(gain)}" for cycle, gain in each.gains.items()) or "no",
            scale.with_sigma(each.rms_dph, each.rms_sigma_dph),
            probability_number(each.probability),
        ]
        for each in closure.effects
    ]
    axes_head = "coefficients" if closure.quantity.axes[0][1:] else f"{closure.quantity.sensor}s"
    return SectionTable(
        f"Size: rms in the dwells searched, without its mean, in {scale.unit}. "
        "Cross-validated: share of chi2 explained in each cycle, with the size fitted to the other cycles. "
        "P: probability of the effect beside any others; that of the verdict excludes an unlisted effect",
        ["effect", axes_head, "tied with", "cross-validated", "size", "P"],
        rows,
        words=4,
    )


def evidence_table(closure: Closure) -> SectionTable:
    """Table of each candidate alone; columns that would be empty are omitted."""
    found_names = set(closure.names)
    tied = closure.tied
    explanations = {
        "share": "" if text.is_noise_only(closure) else "share of excess variance explained",
        "p": "corrected for all candidate fits",
        "odds": "of the effects found to this one" if closure.effects else "",
    }
    columns = {column: explanation for column, explanation in explanations.items() if explanation}
    rows = []
    for each in closure.evidence:
        if each.missing_input is None:
            name = each.effect.name
            cells = {
                "share": share_text(each.share),
                "p": p_text(each.p_value),
                "odds": odds_text(each.log_odds_against) if each.log_odds_against > 0.0 else "",
            }
            status = (
                ["found" if name in found_names else "tied" if name in tied else ""] if found_names else []
            )
            rows.append([each.effect.display_name, *status, *(cells[column] for column in columns)])
    meanings = "; ".join(f"{column}: {meaning}" for column, meaning in columns.items())
    caption = f"Each effect alone. {meanings}"
    text_columns = ["effect", *(["status"] if found_names else [])]
    return SectionTable(caption, [*text_columns, *columns], rows, words=len(text_columns))


def _composed_section(closure: Closure) -> Section | None:
    scale, composed = text.scale_of_errors(closure), closure.composed
    if composed is None:
        return None
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
    rows.append(
        ["no law of the grammar, or one with a remaining residual", "", "", f"{composed.other:.2f}", ""]
    )
    rows.append(["of this: a law with a remaining residual", "", "", f"{composed.law_and_remainder:.2f}", ""])
    table = SectionTable(
        f"Composed laws, of {composed.tried} tried; the best one is composed_law.yaml",
        [f"{closure.quantity.label} follows", "shape", "memory", "P", f"held-out error, {scale.unit}"],
        rows,
        words=3,
    )
    return Section("Composed laws (empirical)", [_COMPOSED_TEXT], [], [table])


def _sizes_table(closure: Closure) -> SectionTable:
    scale = text.scale_of_errors(closure)
    rows = [
        [
            each.effect.display_name,
            term,
            *(
                with_sigma(scale.factor * size, scale.factor * sigma) if size else ""
                for size, sigma in zip(sizes, sigmas, strict=True)
            ),
        ]
        for each in closure.effects
        for term, sizes, sigmas in zip(
            each.candidate.form.terms,
            (each.sizes_dph * each.weights).T,
            each.weighted_sigma_dph.T,
            strict=True,
        )
        if sizes.any()
    ]
    return SectionTable(
        f"Size of each term with its standard uncertainty, in {scale.unit} per unit of what it follows; "
        "empty: not used for it",
        ["effect", "follows", *closure.quantity.headings],
        rows,
        words=2,
    )


def _parameter_tables(closure: Closure) -> list[SectionTable]:
    rows = [
        [each.effect.display_name, parameter]
        for each in closure.effects
        for parameter in (*each.parameter_texts, *(other.text for other in each.other_forms))
    ]
    caption = (
        "Nonlinear parameters with their standard uncertainties, or the interval that holds them with 95 % "
        "where it is not symmetric or ends at a bound of the fit"
    )
    return [SectionTable(caption, ["effect", "parameter"], rows, words=2)] if rows else []


def _alternatives_section(closure: Closure) -> Section:
    has_figure = not text.is_noise_only(closure) or bool(closure.effects)
    caption = _P_VALUES_CAPTION if text.is_noise_only(closure) else _EVIDENCE_CAPTION
    figures = (
        [SectionFigure("evidence", caption, partial(closure_evidence_figure, closure))] if has_figure else []
    )
    paragraphs = [
        text.probability_sentence(closure),
        text.alternative_sentence(closure),
        *text.tie_sentences(closure),
        *text.rejection_sentences(closure),
        *text.missing_input_sentences(closure),
        *closure.confounding,
        text.sensitivity_sentence(closure) if closure.verdict == "clean" else "",
    ]
    title = "Alternatives" if closure.effects else "Candidate effects"
    return Section(title, paragraphs, figures, [evidence_table(closure)])


def _error_section(closure: Closure) -> Section:
    held_out, scale = ~closure.searched, text.scale_of_errors(closure)
    if not held_out.any():
        return Section("Held-out error", [text.held_out_error_sentence(closure)])
    sigma_dph = closure.prediction_sigma_dph[held_out]
    errors = {name: closure.residuals_dph(model) for name, model in text.models_of(closure).items()}
    errors["noise"] = closure.dwell_noise_dph
    rows = [
        [name, *(scale.text(nan_rms(each)) for each in (*values_dph[held_out].T, values_dph[held_out]))]
        for name, values_dph in errors.items()
    ]
    rows.append(["prediction", *(scale.text(nan_rms(each)) for each in (*sigma_dph.T, sigma_dph))])
    table = SectionTable(
        f"Rms of measured minus predicted {closure.quantity.label} in the held-out cycles, of the noise, and "
        f"of the standard uncertainty of the predictions, in {scale.unit}",
        ["", *closure.quantity.headings, "all"],
        rows,
    )
    return Section(
        "Held-out error",
        [
            text.held_out_error_sentence(closure),
            (closure.unexplained_part or "") if closure.differs_held_out else "",
            text.removed_means_sentence(closure),
        ],
        [
            SectionFigure(
                "errors",
                _ERRORS_CAPTION.format(closure.quantity.label),
                partial(closure_error_figure, closure),
            )
        ],
        [table],
    )


def _held_out_in_turn_section(closure: Closure) -> Section | None:
    if not closure.held_out_in_turn:
        return None
    scale = text.scale_of_errors(closure)
    rows = [
        [
            text.cycles_text(closure, [trial.cycle]),
            trial.verdict or f"not possible: {trial.reason}",
            text.labels(closure, trial.effects) or ("none" if trial.verdict else ""),
            *(
                scale.text(value) if trial.verdict else ""
                for value in (trial.error_before_dph, trial.error_after_dph, trial.noise_dph)
            ),
        ]
        for trial in closure.held_out_in_turn
    ]
    table = SectionTable(
        f"Outcome with each cycle held out in turn; rms in that cycle in {scale.unit}",
        ["held out", "verdict", "effects", "before", "after", "noise"],
        rows,
        words=3,
    )
    return Section("Each cycle held out", [text.held_out_in_turn_sentence(closure)], tables=[table])


def _lack_of_fit_section(closure: Closure) -> Section:
    before, after = closure.before, closure.after
    models = text.models_of(closure)
    rows = [["chi2", p_text(before.p_noise), p_text(after.p_noise)]]
    rows += [
        [f"follows {name}", p_text(p_value), p_text(after.p_structure.get(name, np.nan))]
        for name, p_value in before.p_structure.items()
    ]
    table = SectionTable(
        "p-values of the tests of the residual in the dwells searched, not corrected for the number of tests",
        ["test", *models],
        [row[: 1 + len(models)] for row in rows],
    )
    advice = "" if closure.unexplained_part is None or closure.differs_held_out else _UNEXPLAINED_ADVICE
    return Section(
        "Lack of fit",
        [text.remaining_residual_sentence(closure), advice, text.detectable_effect_sentence(closure)],
        tables=[table],
    )


def closure_findings(closure: Closure, source: str = "") -> Findings:
    """Verdict, facts and all sections; ``source`` is the line below the title."""
    return Findings(
        title=text.search_title(closure),
        source=source,
        judgement=closure.verdict,
        colour=_COLOURS[closure.verdict],
        sentence=text.verdict_sentence(closure),
        facts=_facts(closure),
        sections=closure_sections(closure),
    )


def write_closure_page(folder: Path, closure: Closure, source: str, dwells: Path | None = None) -> Path:
    """Write figures and page into an existing folder.

    ``source``: line below the title. ``dwells``: the table searched. Raises RunFolderError if a file can't be
    written.
    """
    findings, sources = closure_findings(closure, source), closure.campaign.sources
    return write_findings(folder / "closure.html", findings, sources, dwells)


def _facts(closure: Closure) -> dict[str, str]:
    campaign, searched = closure.campaign, closure.searched
    cycles = np.unique(campaign.cycle)
    hours = (campaign.end_s.max() - campaign.start_s.min()) / 3600.0
    gyro_c = campaign.gyro_c
    measured = len(campaign.whole) + len(campaign.without_temperatures)
    table_facts = {"tables": "; ".join(text.table_texts(closure))} if len(campaign.tables) > 1 else {}
    row = campaign.quantity.row
    return table_facts | {
        f"{row}s": f"{len(campaign)} of {measured} with a result and without flags, over {hours:.0f} h",
        "cycles": f"{len(cycles)}; {text.held_out_cycles(closure)} held out",
        "searched": f"{counted(int(searched.sum()), row)}; {int((~searched).sum())} held out",
        "power cycles": str(len(campaign.run_names)),
        "gyro temperatures": f"{gyro_c.min():.0f} to {gyro_c.max():.0f} °C",
    }


def write_search(
    closure: Closure, tables: Sequence[Path], folder: Path | None = None
) -> tuple[Path, Path | None]:
    """Write the files of a search and update the report of its run.

    Raises RunFolderError if a file can't be written.

    Parameters
    ----------
    tables : sequence of Path
        Run folders and dwell tables that were searched.
    folder : Path, optional
        Output folder; default: ``closure`` in the run folder or beside the table, ``closure_A_B`` beside the
        first of several tables; for another quantity than gyro biases with its name appended to ``closure``.

    Returns
    -------
    page : Path
    report : Path or None
        Updated run report; None for several tables, a table outside a run or another output folder.
    """
    name = CLOSURE if closure.quantity.is_gyro_bias else f"{CLOSURE}_{closure.quantity.name}"
    first, source = tables[0], ", ".join(map(str, tables))
    if len(tables) > 1:
        names = [path.name if path.is_dir() else path.stem for path in tables]
        folder = folder or first.parent / f"{name}_{'_'.join(names)}"[:_MAX_FOLDER_NAME]
        write_closure(folder, closure)
        return write_closure_page(folder, closure, source), None
    run = RunFolder(first) if first.is_dir() else None
    folder = folder or (run or RunFolder(first.parent)).closure.with_name(name)
    write_closure(folder, closure)
    page = write_closure_page(folder, closure, source, run.dwells if run else first)
    return page, write_report(run).path if run and folder == run.closure else None
