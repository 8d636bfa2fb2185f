"""The page of an investigation (investigation.html): probabilities over time, block by block."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from matplotlib.figure import Figure

from gyrobench.bench.foundations.files import make_folder
from gyrobench.bench.foundations.text import probability_number
from gyrobench.bench.investigation.stages import CALIBRATE, CONFIRM, TEST_LAW, Investigation
from gyrobench.bench.report.closure.closure_page import closure_sections
from gyrobench.bench.report.closure.closure_text import verdict_sentence
from gyrobench.bench.report.content import approvals_in
from gyrobench.bench.report.figures.style import fitted_figure, house_style
from gyrobench.bench.report.investigation import investigation_text as text
from gyrobench.bench.report.page import Findings, Section, SectionFigure, SectionTable, write_findings
from gyrobench.bench.report.verification.verification_page import residual_bars_figure
from gyrobench.bench.report.verification.verification_text import (
    outcome_sentence,
    size_heads,
    size_units,
    total_rows,
)
from gyrobench.bench.runs.provenance import watermark_of
from gyrobench.bench.verification.compensation_verification import VerificationResult

_CURVES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_MIN_DRAWN = 0.02
_PURPOSES = {CONFIRM: ", confirmation", TEST_LAW: ", test of the composed law", CALIBRATE: ", for the biases"}
_OTHERS = {"nothing": ("nothing beside the declared model", "#888888"), "": ("not on the list", "#222222")}


def write_investigation_page(
    folder: Path, found: Investigation, source: str, proof: VerificationResult | None = None
) -> Path:
    """Write figures and page into a folder, with the verification of the compensation if there is one.

    Raises RunFolderError if a file can't be written.
    """
    make_folder(folder)
    first, first_h = found.stages[0].closure.campaign, found.stages[0].spent_h
    findings = Findings(
        title="Investigation",
        source=source,
        judgement=text.GISTS[found.ended],
        colour="finished" if found.is_conclusive else "stopped",
        sentence=" ".join(text.closing_sentences(found)),
        facts={
            "first table": f"{len(first)} dwells, {first_h or found.repeated_campaign_h:.1f} h",
            "blocks": f"{len(found.stages) - 1}, {found.spent_h - first_h:.1f} h",
            "verdict": f"{found.closure.verdict}: {verdict_sentence(found.closure)}",
        },
        watermark=watermark_of(folder, *(Path(each.name) for each in found.closure.campaign.tables)),
        sections=[
            _story(found, approvals_in(folder)),
            *_blocks(found),
            *_proof(proof),
            *closure_sections(found.closure),
        ],
    )
    return write_findings(folder / "investigation.html", findings)


def _story(found: Investigation, approvals: Sequence[str]) -> Section:
    tables = [
        SectionTable("Blocks in the order of time", text.BLOCK_COLUMNS, text.block_rows(found), words=2)
    ]
    refused = [f"{', then '.join(kinds)}: {reason}" for kinds, reason in found.refused.items()]
    return Section(
        "Probabilities over hours on the bench",
        ["Blocks that the bench refused: " + "; ".join(refused) + "."] if refused else [],
        [
            SectionFigure(
                "probabilities",
                "Probability of each effect after each search, by the hours since the first table; numbers: "
                "the blocks of the table below.",
                partial(_probability_figure, found),
            )
        ],
        tables if found.stages[1:] else [],
        items=approvals,
    )


def _blocks(found: Investigation) -> list[Section]:
    sections = []
    for number, stage in enumerate((each for each in found.stages if each.proposal), start=1):
        proposal, outcome = stage.proposal, stage.outcome
        if proposal is None or outcome is None:
            continue
        rows = [
            [
                text.title_of(rival),
                probability_number(rival.probability),
                probability_number(after),
                f"{1e3 * error_dph:.2f}",
            ]
            for rival, after, error_dph in zip(
                stage.rivals, outcome.probabilities, outcome.error_dph, strict=True
            )
        ]
        table = SectionTable(
            "Hypotheses: probability before, probability by the prediction, and rms of measured minus "
            f"predicted bias, 0.001 deg/h; the noise is {1e3 * outcome.noise_dph:.2f}",
            ("hypothesis", "before", "by prediction", "error"),
            rows,
        )
        purpose = _PURPOSES.get(stage.purpose, "")
        sections.append(
            Section(
                f"Block {number}{purpose}: {proposal.block.name}",
                [*text.proposal_sentences(proposal, stage.rivals), text.ruled_out_sentence(stage)],
                tables=[table],
            )
        )
    return sections


def _proof(proof: VerificationResult | None) -> list[Section]:
    if proof is None:
        return []
    caption = f"Remaining biases in new measurements, all plateaus, {size_units(proof)}"
    table = SectionTable(caption, ["compensation", *size_heads(proof)], total_rows(proof))
    bars = SectionFigure("residuals", f"{caption}, by plateau.", partial(residual_bars_figure, proof))
    return [Section("Compensation, before and after", [outcome_sentence(proof)], [bars], [table])]


@house_style
def _probability_figure(found: Investigation) -> Figure:
    """Draw the probability of each effect, of nothing and of what is on no list over the hours."""
    hours = [stage.spent_h for stage in found.stages]
    posteriors = [stage.closure.posterior for stage in found.stages]
    values = [each.of_effect | {"nothing": each.nothing, "": each.not_on_list} for each in posteriors]
    curves = {name: [each.get(name, 0.0) for each in values] for every in values for name in every}
    figure = fitted_figure(3.4)
    axes = figure.subplots()
    shown = sorted(
        (each for each in curves if max(curves[each]) > _MIN_DRAWN), key=lambda each: -max(curves[each])
    )
    colours = iter(_CURVES)
    for name in shown:
        label, colour = _OTHERS.get(name, (found.closure.label(name), ""))
        axes.plot(
            hours,
            curves[name],
            marker="o",
            markersize=4,
            label=label,
            color=colour or next(colours, "#AAAAAA"),
        )
    axes.axhline(0.99, color="#888888", linewidth=0.8, linestyle=":")
    for number, (stage, after) in enumerate(zip(found.stages[:-1], found.stages[1:], strict=True), start=1):
        tint = "#EEEEEE" if number % 2 else "#FAFAFA"
        axes.axvspan(stage.spent_h, after.spent_h, color=tint, linewidth=0.0, zorder=0)
        middle = 0.5 * (stage.spent_h + after.spent_h)
        axes.annotate(str(number), (middle, 1.04), ha="center", fontsize=7, annotation_clip=False)
    if found.spent_h > 0.5 * found.repeated_campaign_h:
        axes.axvline(found.repeated_campaign_h, color="#888888", linewidth=0.8, label="campaign repeated")
    axes.set(xlabel="hours on the bench since the first table", ylabel="probability", ylim=(-0.02, 1.02))
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
