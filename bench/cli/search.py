"""A search for effects, as `close` and `verify` make it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bench.cli.exit_codes import EXIT_WRONG_INPUT, fail
from bench.errors import MeasurementError, RunFolderError

if TYPE_CHECKING:
    from bench.closure.closure import Closure


def search(campaign: Path, hold_out_cycles: Sequence[int]) -> Closure:
    """Search in a dwell table or run folder; exits where it can't be used."""
    from bench.closure.closure import close_loop
    from bench.measurement.campaign import read_campaign

    try:
        return close_loop(read_campaign(campaign), hold_out_cycles)
    except (MeasurementError, RunFolderError) as error:
        fail(error, EXIT_WRONG_INPUT)


def write_search(folder: Path, closure: Closure, campaign: Path) -> Path:
    """Write what a search found; returns the page."""
    from bench.closure.files import write_closure
    from bench.report.closure.page import write_closure_page
    from bench.run_store.folder import RunFolder

    write_closure(folder, closure)
    dwells = RunFolder(campaign).dwells if campaign.is_dir() else campaign
    return write_closure_page(folder, closure, str(campaign), dwells)
