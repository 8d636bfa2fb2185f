"""The page of a proof of a compensation, with its figures: ``comparison.html`` and ``figures/``."""

from __future__ import annotations

from pathlib import Path

from bench.files import write_whole
from bench.measurement.comparison import Comparison
from bench.report.closure_wording import verdict_sentence
from bench.report.pages import render_page
from bench.report.section_figures import save_section_figures
from bench.report.verify_section import verify_sections
from bench.report.verify_wording import (
    BETTER,
    CONFIRMED,
    LABELS,
    NOT_CONFIRMED,
    NOTHING_TO_TELL,
    outcome,
    outcome_sentence,
)
from bench.report.wording import counted, listed

_TEMPLATE = "verify.html.j2"
#: Colours of the template's box, by judgement.
_COLOURS = {CONFIRMED: "finished", BETTER: "stopped", NOT_CONFIRMED: "failed", NOTHING_TO_TELL: "stopped"}


def write_verify_page(folder: Path, comparison: Comparison) -> Path:
    """Write figures and page into a folder that is there.

    Parameters
    ----------
    folder : Path
        Where to write.
    comparison : Comparison
        With one compensation measured at least.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    RunFolderError
        A file can't be written.
    """
    sections = verify_sections(comparison)
    page = render_page(
        _TEMPLATE,
        save_section_figures(folder / "figures", sections),
        source=comparison.source,
        outcome=outcome(comparison),
        colour=_COLOURS[outcome(comparison)],
        sentence=outcome_sentence(comparison),
        facts=_facts(comparison),
        sections=sections,
    )
    path = folder / "comparison.html"
    write_whole(path, page.encode())
    return path


def _facts(comparison: Comparison) -> dict[str, str]:
    closure = comparison.closure
    measured = [LABELS[each.compensation] for each in comparison.leftovers]
    return {
        "search": f"{closure.verdict}. {verdict_sentence(closure)}",
        "compensations": f"{counted(len(measured), 'run')}: {listed(measured)}",
        "dwells": f"{comparison.dwells} a run, at {counted(len(comparison.leftovers[0].rows), 'stop')}",
    }
