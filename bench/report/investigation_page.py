"""The page of an investigation (investigation.html): probabilities over time, block by block.

Sentences and rows of its tables are also for the terminal.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.foundations.files import make_folder
from gyrobench.bench.foundations.text import capitalised, counted, listed, probability_number
from gyrobench.bench.investigation.choice import Rival
from gyrobench.bench.investigation.open_hypotheses import rivals_of
from gyrobench.bench.investigation.proposal import Proposal
from gyrobench.bench.investigation.stages import CALIBRATE, CONFIRM, TEST_LAW, Investigation, Stage
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.report.closure_page import closure_sections
from gyrobench.bench.report.closure_text import verdict_sentence
from gyrobench.bench.report.figures.closure import probability_figure
from gyrobench.bench.report.figures.verification import residual_bars_figure
from gyrobench.bench.report.page import Findings, Section, SectionFigure, SectionTable, write_findings
from gyrobench.bench.report.run_content import approvals_in
from gyrobench.bench.report.verification_text import outcome_sentence, size_heads, size_units, total_rows
from gyrobench.bench.verification.compensation_verification import VerificationResult

#: Judgement as displayed, by how the investigation ended.
JUDGEMENTS = {
    "settled": "settled",
    "nothing_found": "nothing found",
    "not_on_list": "not on the list of effects",
    "budget": "not settled within the budget",
    "no_block": "not settled on this bench",
    "declined": "stopped",
    "refuted": "refuted",
    "bench_failed": "stopped: the bench failed",
}
_MAX_PREDICTIONS = 3
#: Hypotheses below this probability are ruled out.
_MAX_RULED_OUT_PROBABILITY = 0.01


def hypothesis_label(rival: Rival) -> str:
    """A hypothesis in words."""
    names = listed(rival.labels) or "nothing beyond the declared model"
    return f"{names}, and an unlisted effect" if rival.remainder_dph else names


def proposal_sentences(proposal: Proposal, rivals: Sequence[Rival]) -> Iterator[str]:
    """Steps of a block, its expected gain of information, and the prediction of each hypothesis."""
    plan = proposal.block.plan
    biases = f" For the biases it replaces {proposal.replaced_h:.1f} h of the procedure."
    yield (
        f"{capitalised(proposal.block.instruction)}: {counted(len(plan.dwells), 'dwell')} in "
        f"{plan.duration_h:.1f} h. The entropy of the probabilities is expected to fall from "
        f"{proposal.entropy:z.2f} to {proposal.expected.entropy:z.2f} nats."
        f"{biases if proposal.replaced_h else ''}"
    )
    is_test = len(rivals) > 1 and len({each.probability for each in rivals}) == 1
    for rival, prediction in list(zip(rivals, proposal.predictions, strict=True))[:_MAX_PREDICTIONS]:
        weight = f"probability {probability_number(rival.probability)}"
        mean_dph = prediction.mean_dph.reshape(3, -1)
        gyros = ", ".join(
            f"{axis} {1e3 * each.mean():+z.1f}" for axis, each in zip(AXES, mean_dph, strict=True)
        )
        yield (
            f"If it is {hypothesis_label(rival)} ({'equal weights for the test' if is_test else weight}), "
            f"the mean biases are {gyros} x 0.001 deg/h."
        )


def ruled_out_sentence(stage: Stage) -> str:
    """Hypotheses that the results of a block rule out; empty if none."""
    after = stage.outcome.probabilities if stage.outcome else ()
    names = [
        hypothesis_label(rival)
        for rival, probability in zip(stage.rivals, after, strict=False)
        if rival.probability > _MAX_RULED_OUT_PROBABILITY > probability
    ]
    return f"Ruled out by what it predicted: {'; '.join(names)}." if names else ""


def _end_sentence(investigation: Investigation) -> str:
    """How the investigation ended, and its cost."""
    share_text = f"{100.0 * investigation.spent_h / investigation.repeated_campaign_h:.0f} %"
    if investigation.calibration:
        comparison = f"{share_text} of the whole procedure ({investigation.repeated_campaign_h:.1f} h)"
        return f"{investigation.reason} {investigation.spent_h:.1f} h on the bench, {comparison}."
    block_text = (
        f", {counted(len(investigation.stages) - 1, 'block')} {investigation.spent_h:.1f} h"
        if investigation.spent_h
        else ""
    )
    comparison = f" ({share_text} of a repeat of the first table)" if block_text else ""
    return (
        f"{investigation.reason} On the bench: first table {investigation.repeated_campaign_h:.1f} "
        f"h{block_text}{comparison}."
    )


def _calibration_sentence(investigation: Investigation) -> str:
    """Uncertainty of the biases of an adaptive campaign; empty for other campaigns."""
    if investigation.calibration is None:
        return ""
    return (
        "The rms standard uncertainty of the biases of a gyro, predicted for the procedure, is at most "
        f"{investigation.calibration.ratio:.2f} times that of measuring it."
    )


def test_sentence(investigation: Investigation) -> str:
    """Result of the block that tested the effects found or a composed law; empty without such a block."""
    stage = investigation.test
    if stage is None or stage.outcome is None:
        return ""
    error_with, *errors_without = stage.outcome.error_dph
    error_without = min(errors_without)
    probability, tested = stage.outcome.probabilities[0], stage.rivals[0]
    result_words = ("agrees with", "contradicts")
    if stage.purpose == CONFIRM:
        is_stated = set(tested.names) == set(investigation.closure.names)
        stated = "the effects found" if len(tested.names) > 1 else "the effect found"
        subject = (
            stated if is_stated else f"{hypothesis_label(tested)}, which is not stated by the last search"
        )
    else:
        subject = f"the composed law ({tested.candidates[-1].effect.statement})"
        result_words = ("confirms", "refutes")
    result, removed = "leaves open", "one of them" if len(errors_without) > 1 else "it"
    if not stage.outcome.fits:
        models = "the declared model" if len(errors_without) == 1 else f"the effects found without {removed}"
        result = f"fits neither {models} nor"
    elif probability >= 1.0 - _MAX_RULED_OUT_PROBABILITY or probability <= _MAX_RULED_OUT_PROBABILITY:
        result = result_words[0] if probability > 0.5 else result_words[1]
    return (
        f"A block predicted before it was measured {result} {subject}: rms error {1e3 * error_without:.2f} x "
        f"0.001 deg/h without {removed}, {1e3 * error_with:.2f} with it, noise "
        f"{1e3 * stage.outcome.noise_dph:.2f}."
    )


def forecast_sentence(investigation: Investigation) -> str:
    """Blocks whose temperatures differ far from their forecast; empty if none."""
    deviations_k = {
        str(block_number): stage.outcome.off_forecast_k
        for block_number, stage in enumerate(investigation.stages, start=1)
        if stage.outcome and stage.outcome.off_forecast_k
    }
    if not deviations_k:
        return ""
    return (
        f"The gyro temperatures of block {listed([*deviations_k])} differ by up to "
        f"{max(deviations_k.values()):.0f} K from the forecast. Check that the bench carries out the steps "
        "of its plan."
    )


def closing_sentences(investigation: Investigation) -> list[str]:
    """How the investigation ended, the result of its test, and what to check."""
    sentences = (_end_sentence, _calibration_sentence, test_sentence, forecast_sentence)
    return [text for sentence in sentences if (text := sentence(investigation))]


def block_rows(investigation: Investigation) -> list[list[str]]:
    """One row for each block: name, hours, most probable hypothesis before and after."""
    rows = []
    for block_number, stage in enumerate(investigation.stages[:-1], start=1):
        after = investigation.stages[block_number]
        if stage.proposal is not None:
            rows.append(
                [
                    str(block_number),
                    stage.proposal.block.name,
                    f"{after.spent_h - stage.spent_h:.1f}",
                    _most_probable(stage.closure),
                    _most_probable(after.closure),
                ]
            )
    return rows


BLOCK_COLUMNS = ("block", "what", "hours", "most probable before", "after")


def _most_probable(closure: Closure) -> str:
    best = rivals_of(closure)[0]
    return f"{hypothesis_label(best)}, {probability_number(best.probability)}"


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
        judgement=JUDGEMENTS[investigation.ended],
        colour="finished" if investigation.is_conclusive else "stopped",
        sentence=" ".join(closing_sentences(investigation)),
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
    tables = [SectionTable("Blocks in the order of time", BLOCK_COLUMNS, block_rows(investigation), words=2)]
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
                hypothesis_label(rival),
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
                [*proposal_sentences(proposal, stage.rivals), ruled_out_sentence(stage)],
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
