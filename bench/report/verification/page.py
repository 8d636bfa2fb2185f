"""The page of a proof of a compensation, with its figures: ``comparison.html`` and ``figures/``."""

from __future__ import annotations

from pathlib import Path

from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.foundations.text import counted, listed
from gyrobench.bench.report.closure.wording import verdict_sentence
from gyrobench.bench.report.page import Findings, write_findings
from gyrobench.bench.report.verification.section import verify_sections
from gyrobench.bench.report.verification.wording import (
    BETTER,
    CONFIRMED,
    LABELS,
    NOT_CONFIRMED,
    NOTHING_TO_TELL,
    outcome,
    outcome_sentence,
)
from gyrobench.bench.verification.comparison import Comparison

#: Colours of the template's box, by judgement.
_COLOURS = {CONFIRMED: "finished", BETTER: "stopped", NOT_CONFIRMED: "failed", NOTHING_TO_TELL: "stopped"}


def write_verify_page(folder: Path, comparison: Comparison, dwells: Path | None = None) -> Path:
    """Write figures and page into a folder that is there.

    Parameters
    ----------
    folder : Path
        Where to write.
    comparison : Comparison
        With one compensation measured at least.
    dwells : Path, optional
        The dwell table that the model was fitted to; the report of its run takes in findings with its
        hash alone.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    RunFolderError
        A file can't be written.
    """
    judgement = outcome(comparison)
    findings = Findings(
        title="Proof of a compensation",
        source=comparison.source,
        judgement=judgement,
        colour=_COLOURS[judgement],
        sentence=outcome_sentence(comparison),
        facts=_facts(comparison),
        sections=verify_sections(comparison),
        dwells_sha256=file_sha256(dwells) if dwells else "",
    )
    return write_findings(folder / "comparison.html", findings)


def _facts(comparison: Comparison) -> dict[str, str]:
    closure = comparison.closure
    measured = [LABELS[each.compensation] for each in comparison.leftovers]
    return {
        "search": f"{closure.verdict}. {verdict_sentence(closure)}",
        "compensations": f"{counted(len(measured), 'run')}: {listed(measured)}",
        "dwells": f"{comparison.dwells} a run, at {counted(len(comparison.leftovers[0].rows), 'stop')}",
    }
