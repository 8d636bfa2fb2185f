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
from gyrobench.bench.report.figures.investigation import probability_figure
from gyrobench.bench.report.figures.verification import residual_bars_figure
from gyrobench.bench.report.page import Findings, Section, SectionFigure, SectionTable, write_findings
from gyrobench.bench.report.run_content import approvals_in
from gyrobench.bench.report.verification_text import outcome_sentence, size_heads, size_units, total_rows
from gyrobench.bench.runs.provenance import watermark_of
from gyrobench.bench.verification.compensation_verification import VerificationResult

_PURPOSES = {CONFIRM: ", confirmation", TEST_LAW: ", test of the composed law", CALIBRATE: ", for the biases"}


def write_investigation_page(
    folder: Path, found: Investigation, source: str, proof: VerificationResult | None
) -> Path:
    """Write figures and page into a folder, with the verification of the compensation if there is one.

    Raises RunFolderError if a file can't be written.
    """
    make_folder(folder)
    first, first_h = found.stages[0].closure.campaign, found.stages[0].spent_h
    findings = Findings(
        title="Investigation",
        source=source,
        judgement=text.JUDGEMENTS[found.ended],
        colour="finished" if found.is_conclusive else "stopped",
        sentence=" ".join(text.closing_sentences(found)),
        facts={
            "first table": f"{len(first)} dwells, {first_h or found.repeated_campaign_h:.1f} h",
            "blocks": f"{len(found.stages) - 1}, {found.spent_h - first_h:.1f} h",
            "verdict": f"{found.closure.verdict}: {verdict_sentence(found.closure)}",
        },
        watermark=watermark_of(folder, *found.closure.campaign.sources),
        sections=[
            _history(found, approvals_in(folder)),
            *_blocks(found),
            *_proof(proof),
            *closure_sections(found.closure),
        ],
    )
    return write_findings(folder / "investigation.html", findings)


def _history(found: Investigation, approvals: Sequence[str]) -> Section:
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
                partial(probability_figure, found),
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
