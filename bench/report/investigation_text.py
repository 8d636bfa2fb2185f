"""Sentences and tables of an investigation, for page and terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.foundations.text import capitalised, counted, listed, probability_number
from gyrobench.bench.investigation.choice import Rival
from gyrobench.bench.investigation.open_hypotheses import rivals_of
from gyrobench.bench.investigation.proposal import Proposal
from gyrobench.bench.investigation.stages import CONFIRM, Investigation, Stage
from gyrobench.bench.navigation.positions import AXES

#: Judgement of each end.
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
_RULED_OUT = 0.01


def title_of(rival: Rival) -> str:
    """A hypothesis in words."""
    names = listed(rival.labels) or "nothing beyond the declared model"
    return f"{names}, and an unlisted effect" if rival.remainder_dph else names


def proposal_sentences(proposal: Proposal, rivals: Sequence[Rival]) -> Iterator[str]:
    """What a block does, what it is worth, and what each hypothesis predicts."""
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
            f"If it is {title_of(rival)} ({'equal weights for the test' if is_test else weight}), the mean "
            f"biases are {gyros} x 0.001 deg/h."
        )


def ruled_out_sentence(stage: Stage) -> str:
    """Hypotheses that a block made improbable; empty without any."""
    after = stage.outcome.probabilities if stage.outcome else ()
    names = [
        title_of(rival)
        for rival, probability in zip(stage.rivals, after, strict=False)
        if rival.probability > _RULED_OUT > probability
    ]
    return f"Ruled out by what it predicted: {'; '.join(names)}." if names else ""


def _end_sentence(found: Investigation) -> str:
    """How the investigation ended, and its cost."""
    share = f"{100.0 * found.spent_h / found.repeated_campaign_h:.0f} %"
    if found.calibration:
        whole = f"{share} of the whole procedure ({found.repeated_campaign_h:.1f} h)"
        return f"{found.reason} {found.spent_h:.1f} h on the bench, {whole}."
    blocks = f", {counted(len(found.stages) - 1, 'block')} {found.spent_h:.1f} h" if found.spent_h else ""
    whole = f" ({share} of repeating the first)" if blocks else ""
    return f"{found.reason} On the bench: first table {found.repeated_campaign_h:.1f} h{blocks}{whole}."


def _calibration_sentence(found: Investigation) -> str:
    """How certain the biases of an adaptive campaign are; empty for others."""
    if found.calibration is None:
        return ""
    return (
        "The rms standard uncertainty of the biases of a gyro, predicted for the procedure, is at most "
        f"{found.calibration.ratio:.2f} times that of measuring it."
    )


def test_sentence(found: Investigation) -> str:
    """What the block that tested the effects found or a composed law says about them; empty without one."""
    stage = found.test
    if stage is None or stage.outcome is None:
        return ""
    after, *others = stage.outcome.error_dph
    before = min(others)
    probability, tested = stage.outcome.probabilities[0], stage.rivals[0]
    words = ("agrees with", "contradicts")
    if stage.purpose == CONFIRM:
        is_stated = set(tested.names) == set(found.closure.names)
        own = "the effects found" if len(tested.names) > 1 else "the effect found"
        subject = own if is_stated else f"{title_of(tested)}, which is not stated by the last search"
    else:
        subject, words = (
            f"the composed law ({tested.candidates[-1].effect.statement})",
            ("confirms", "refutes"),
        )
    held, part = "leaves open", "one of them" if len(others) > 1 else "it"
    if not stage.outcome.fits:
        without = "the declared model" if len(others) == 1 else f"the effects found without {part}"
        held = f"fits neither {without} nor"
    elif probability >= 1.0 - _RULED_OUT or probability <= _RULED_OUT:
        held = words[0] if probability > 0.5 else words[1]
    return (
        f"A block predicted before it was measured {held} {subject}: rms error {1e3 * before:.2f} x 0.001 "
        f"deg/h without {part}, {1e3 * after:.2f} with it, noise {1e3 * stage.outcome.noise_dph:.2f}."
    )


def forecast_sentence(found: Investigation) -> str:
    """Blocks whose temperatures are far from their forecast; empty without any."""
    off_k = {
        str(number): stage.outcome.off_forecast_k
        for number, stage in enumerate(found.stages, start=1)
        if stage.outcome and stage.outcome.off_forecast_k
    }
    if not off_k:
        return ""
    return (
        f"The gyro temperatures of block {listed([*off_k])} differ by up to {max(off_k.values()):.0f} K from "
        "the forecast. Check that the bench carries out the steps of its plan."
    )


def closing_sentences(found: Investigation) -> list[str]:
    """How the investigation ended, what its test says, and what to check."""
    return [
        *filter(
            None,
            [
                _end_sentence(found),
                _calibration_sentence(found),
                test_sentence(found),
                forecast_sentence(found),
            ],
        )
    ]


def block_rows(found: Investigation) -> list[list[str]]:
    """A row for each block: what, hours, and what was most probable before and after."""
    rows = []
    for number, stage in enumerate(found.stages[:-1], start=1):
        after = found.stages[number]
        if stage.proposal is not None:
            rows.append(
                [
                    str(number),
                    stage.proposal.block.name,
                    f"{after.spent_h - stage.spent_h:.1f}",
                    _leading(stage.closure),
                    _leading(after.closure),
                ]
            )
    return rows


BLOCK_COLUMNS = ("block", "what", "hours", "most probable before", "after")


def _leading(closure: Closure) -> str:
    best = rivals_of(closure)[0]
    return f"{title_of(best)}, {probability_number(best.probability)}"
