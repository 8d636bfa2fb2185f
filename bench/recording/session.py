"""Recording sessions from file names: each opens the bench, records, tells, and closes it again."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import ConnectionFailedError, DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.recording.can_log import record_can
from gyrobench.bench.recording.proxy import proxy
from gyrobench.bench.recording.record import Instrument, headers, record_questions
from gyrobench.bench.station.bench_lock import BenchLock
from gyrobench.bench.station.instruments import Emulation
from gyrobench.bench.station.station import Station
from gyrobench.drivers.recording.tap import recording_lines

_LISTEN_S = 10.0


class Recorder:
    """Records the instruments of a station.

    Parameters
    ----------
    station : str
        File, or name of a shipped one.
    emulation : Emulation
        World behind emulated instruments.
    note : str
        Goes into the recordings.
    tell : callable
        Gets a line for whoever watches.

    Raises
    ------
    DocumentError
        The station file is wrong.
    """

    def __init__(self, station: str, emulation: Emulation, note: str, tell: Callable[[str], object]) -> None:
        self._station = Station(find_document("stations", station))
        self._emulation = emulation
        self._note = note
        self._tell = tell

    @contextlib.contextmanager
    def lines(self, folder: Path) -> Iterator[None]:
        """Record table and chamber into a folder, whatever opens their lines meanwhile."""
        before = set(folder.glob("*.rec"))
        with recording_lines(folder, headers(self._station, self._note)):
            try:
                yield
            finally:
                made = sorted(set(folder.glob("*.rec")) - before)
                self._tell(f"Recorded {', '.join(map(str, made)) or 'nothing: no line was opened'}")

    def ask(self, instrument: Instrument, path: Path, listen_s: float | None) -> None:
        """Ask an instrument what can be asked without moving anything, or listen to the INS.

        Raises
        ------
        BenchInUseError
            A run holds the bench.
        InstrumentError
            It can't be reached.
        """
        _check_absent(path)
        clock = self._station.new_clock()
        with BenchLock(self._station, path.parent, clock):
            if instrument == "ins":
                told = record_can(self._station, path, clock, self._emulation, listen_s or _LISTEN_S)
                self._tell(told)
            else:
                calls = record_questions(self._station, instrument, path, clock, self._emulation, self._note)
                for call in calls:
                    self._tell(f"{call.ask}: {call.outcome()}")
        self._tell(f"Recorded {path}")

    def proxy(self, instrument: Instrument, path: Path, where: str, duration_s: float | None) -> None:
        """Serve an instrument to other programs until Ctrl-C; raises what :meth:`ask` raises."""
        _check_absent(path)
        clock = WallClock()
        with (
            BenchLock(self._station, path.parent, clock),
            proxy(self._station, instrument, path, clock, where, self._note) as (between, url),
        ):
            self._tell(f"The {instrument} is at {url}; Ctrl-C ends the recording.")
            try:
                between.pass_on(duration_s)
            except KeyboardInterrupt:
                pass
            except OSError as error:
                raise ConnectionFailedError(instrument, f"its port went away: {error}") from error
        self._tell(f"Recorded {path}")


def _check_absent(path: Path) -> None:
    if path.exists():
        raise DocumentError(f"{path}: exists already; choose another name, or remove it")
