"""The page of a search for effects, with its figures: ``closure.html`` and ``figures/``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gyrobench.bench.closure.loop import Closure
from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.report.closure.residuals import held_out_cycles
from gyrobench.bench.report.closure.section import closure_sections
from gyrobench.bench.report.closure.wording import verdict_sentence
from gyrobench.bench.report.page import Findings, write_findings

#: Colours of the template's box, by verdict.
_COLOURS = {"clean": "finished", "explained": "finished", "ambiguous": "stopped", "unexplained": "failed"}


def write_closure_page(folder: Path, closure: Closure, source: str, dwells: Path | None = None) -> Path:
    """Write figures and page into a folder that is there.

    Parameters
    ----------
    folder : Path
        Where to write.
    closure : Closure
        Outcome of a search.
    source : str
        What was searched, for people.
    dwells : Path, optional
        The dwell table that was searched; the report of its run takes in findings with its hash alone.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    RunFolderError
        A file can't be written.
    """
    findings = Findings(
        title="Search for effects",
        source=source,
        judgement=closure.verdict,
        colour=_COLOURS[closure.verdict],
        sentence=verdict_sentence(closure),
        facts=_facts(closure),
        sections=closure_sections(closure),
        dwells_sha256=file_sha256(dwells) if dwells else "",
    )
    return write_findings(folder / "closure.html", findings)


def _facts(closure: Closure) -> dict[str, str]:
    campaign, searched = closure.campaign, closure.searched
    cycles = np.unique(campaign.cycle)
    hours = (campaign.end_s.max() - campaign.start_s.min()) / 3600.0
    gyro_c = campaign.gyro_c
    measured = len(campaign.whole) + len(campaign.without_temperatures)
    return {
        "dwells": f"{len(campaign)} of {measured} have a result without flags, over {hours:.0f} h",
        "cycles": f"{len(cycles)}; {held_out_cycles(closure)} held out",
        "searched": f"{counted(int(searched.sum()), 'dwell')}; {int((~searched).sum())} held out",
        "power-ons": str(len(campaign.run_names)),
        "gyro temperatures": f"{gyro_c.min():.0f} to {gyro_c.max():.0f} °C",
    }
