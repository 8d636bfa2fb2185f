"""The page of an investigation (investigation.html): probabilities over time, block by block."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from gyrobench.bench.foundations.files import make_folder
from gyrobench.bench.foundations.text import probability_number
from gyrobench.bench.investigation.stages import CALIBRATE, CONFIRM, TEST_LAW, Investigation
from gyrobench.bench.report import investigation_text as text
from gyrobench.bench.report.closure_page import closure_sections
from gyrobench.bench.report.closure_text import verdict_sentence
from gyrobench.bench.report.figures.closure import probability_figure
from gyrobench.bench.report.figures.verification import residual_bars_figure
from gyrobench.bench.report.page import Findings, Section, SectionFigure, SectionTable, write_findings
from gyrobench.bench.report.run_content import approvals_in
from gyrobench.bench.report.verification_text import outcome_sentence, size_heads, size_units, total_rows
from gyrobench.bench.verification.compensation_verification import VerificationResult

_PURPOSE_TITLES = {
    CONFIRM: ", confirmation",
    TEST_LAW: ", test of the composed law",
    CALIBRATE: ", for the biases",
}


def write_investigation_page(
    folder: Path, investigation: Investigation, source: str, verification: VerificationResult | None
) -> Path:
    """Write figures and page into a folder, including the verification of the compensation if given.

    Raises RunFolderError if a file can't be written.
    """
    make_folder(folder)
    campaign, first_h = investigation.stages[0].closure.campaign, investigation.stages[0].spent_h
    findings = Findings(
        title="Investigation",
        source=source,
        judgement=text.JUDGEMENTS[investigation.ended],
        colour="finished" if investigation.is_conclusive else "stopped",
        sentence=" ".join(text.closing_sentences(investigation)),
        facts={
            "first table": f"{len(campaign)} dwells, {first_h or investigation.repeated_campaign_h:.1f} h",
            "blocks": f"{len(investigation.stages) - 1}, {investigation.spent_h - first_h:.1f} h",
            "verdict": f"{investigation.closure.verdict}: {verdict_sentence(investigation.closure)}",
        },
        sections=[
            _history_section(investigation, approvals_in(folder)),
            *_block_sections(investigation),
            *_verification_section(verification),
            *closure_sections(investigation.closure),
        ],
    )
    return write_findings(folder / "investigation.html", findings, investigation.closure.campaign.sources)


def _history_section(investigation: Investigation, approvals: Sequence[str]) -> Section:
    tables = [
        SectionTable(
            "Blocks in the order of time", text.BLOCK_COLUMNS, text.block_rows(investigation), words=2
        )
    ]
    refused = [f"{', then '.join(kinds)}: {reason}" for kinds, reason in investigation.refused.items()]
    return Section(
        "Probabilities over hours on the bench",
        ["Blocks that the bench refused: " + "; ".join(refused) + "."] if refused else [],
        [
            SectionFigure(
                "probabilities",
                "Probability of each effect after each search, by the hours since the first table; numbers: "
                "the blocks of the table below.",
                partial(probability_figure, investigation),
            )
        ],
        tables if investigation.stages[1:] else [],
        items=approvals,
    )


def _block_sections(investigation: Investigation) -> list[Section]:
    sections = []
    for block_number, stage in enumerate((each for each in investigation.stages if each.proposal), start=1):
        proposal, outcome = stage.proposal, stage.outcome
        if proposal is None or outcome is None:
            continue
        rows = [
            [
                text.hypothesis_label(rival),
                probability_number(rival.probability),
                probability_number(predicted_probability),
                f"{1e3 * error_dph:.2f}",
            ]
            for rival, predicted_probability, error_dph in zip(
                stage.rivals, outcome.probabilities, outcome.error_dph, strict=True
            )
        ]
        table = SectionTable(
            "Hypotheses: probability before, probability by the prediction, and rms of measured minus "
            f"predicted bias, 0.001 deg/h; the noise is {1e3 * outcome.noise_dph:.2f}",
            ("hypothesis", "before", "by prediction", "error"),
            rows,
        )
        purpose = _PURPOSE_TITLES.get(stage.purpose, "")
        sections.append(
            Section(
                f"Block {block_number}{purpose}: {proposal.block.name}",
                [*text.proposal_sentences(proposal, stage.rivals), text.ruled_out_sentence(stage)],
                tables=[table],
            )
        )
    return sections


def _verification_section(verification: VerificationResult | None) -> list[Section]:
    if verification is None:
        return []
    caption = f"Remaining biases in new measurements, all plateaus, {size_units(verification)}"
    table = SectionTable(caption, ["compensation", *size_heads(verification)], total_rows(verification))
    bars = SectionFigure("residuals", f"{caption}, by plateau.", partial(residual_bars_figure, verification))
    return [Section("Compensation, before and after", [outcome_sentence(verification)], [bars], [table])]
