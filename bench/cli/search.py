"""A search for effects, as `close` and `verify` make it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gyrobench.bench.foundations.errors import DocumentError, MeasurementError, RunFolderError

if TYPE_CHECKING:
    from gyrobench.bench.closure.loop import Closure


def search(campaign: Path, hold_out_cycles: Sequence[int]) -> Closure:
    """Search in a dwell table or run folder.

    Raises
    ------
    DocumentError
        It can't be used for a search.
    """
    from gyrobench.bench.closure.loop import close_loop
    from gyrobench.bench.dwells.campaign import read_campaign

    try:
        return close_loop(read_campaign(campaign), hold_out_cycles)
    except (MeasurementError, RunFolderError) as error:
        raise DocumentError(str(error)) from error
