"""What somebody wants of a run, and in which formats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.text import listed


class What(StrEnum):
    """What can be exported."""

    DWELLS = "dwells"
    BINS = "bins"
    JOINT = "joint"
    VERIFICATION = "verification"
    TELEMETRY = "telemetry"
    NAVIGATION = "navigation"
    CAN = "can"
    COMPENSATION = "compensation"


class Format(StrEnum):
    """Formats of files."""

    PARQUET = "parquet"
    CSV = "csv"
    BLF = "blf"
    MF4 = "mf4"


_OF_CAN = (Format.BLF, Format.MF4)
_OF_TABLES = (Format.PARQUET, Format.CSV)
#: What is written where nobody says so; navigation of a whole run is large, and seldom wanted.
_USUAL = tuple(what for what in What if what is not What.NAVIGATION)
_USUAL_FORMATS = (Format.PARQUET, Format.BLF)


@dataclass(frozen=True)
class Wanted:
    """What somebody wants of a run.

    Attributes
    ----------
    what : sequence of What
        Empty for all that is usual.
    formats : sequence of Format
        Empty for Parquet and BLF. What has none of them is left out.
    dwell : int or None
        Navigation of this dwell alone.

    Raises
    ------
    DocumentError
        Something that is asked for by name has none of the formats, or a dwell is chosen of nothing.
    """

    what: Sequence[What] = ()
    formats: Sequence[Format] = ()
    dwell: int | None = None

    def __post_init__(self) -> None:
        unfit = [str(what) for what in self.what if not self.suffixes(what)]
        if unfit:
            raise DocumentError(
                f"--format {','.join(self.formats)} does not fit {listed(unfit)}: CAN frames are blf "
                "or mf4, all else as parquet or csv"
            )
        if self.dwell is not None and What.NAVIGATION not in self.what:
            raise DocumentError("--dwell chooses a dwell of the navigation; give --what navigation as well")

    def suffixes(self, what: What) -> list[str]:
        """Endings of the files that something is written to."""
        can_be = _OF_CAN if what is What.CAN else _OF_TABLES
        return [f".{each}" for each in self.formats or _USUAL_FORMATS if each in can_be]

    def kinds(self) -> list[What]:
        """What is to be written."""
        return [what for what in self.what or _USUAL if self.suffixes(what)]
