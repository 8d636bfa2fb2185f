"""pytest plugin: procedures on the emulated bench as tests.

    @pytest.mark.emulated_bench(station="stations/ours.yaml", faults="faults/lost_frames.yaml")
    @pytest.mark.worlds("gyro_a", "gyro_b")
    def test_our_procedure_measures_every_position(run_procedure):
        run = run_procedure("procedures/ours.yaml")
        assert set(run.dwells["position"]) >= {"z_up", "z_down"}

A test that fails shows the journal of each run that it made. Stations with real instruments are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from gyrobench.bench.api import Run
    from gyrobench.bench.engine.run_outcome import FailOn

_MARK, _WORLDS = "emulated_bench", "worlds"
#: Of the journal that a failed test shows: the last entries, and the longest line.
_MAX_ENTRIES, _MAX_WIDTH = 40, 200
_RUN_FOLDERS = pytest.StashKey[list[Path]]()


@dataclass(frozen=True)
class EmulatedBench:
    """What a procedure runs on; station, world and faults are files by path, or shipped ones by name."""

    station: str = "emulated"
    world: str | None = None  #: By default the shipped one with the name of the station.
    seed: int = 0  #: Of everything random in the world.
    faults: str = ""  #: None if empty.
    folder: Path = field(default_factory=Path)  #: Where run folders are made.


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of :mod:`gyrobench.conformance`."""
    group = parser.getgroup("gyrobench")
    group.addoption(
        "--dialect",
        action="append",
        default=[],
        metavar="NAME",
        help="dialect that gyrobench.conformance tests, by default all that are installed; can be repeated",
    )
    group.addoption(
        "--dialect-option",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="key of the dialect in a station file, for gyrobench.conformance; can be repeated",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Register the markers."""
    config.addinivalue_line(
        "markers", f"{_MARK}(station, world, seed, faults): what the fixture of that name is made of"
    )
    config.addinivalue_line("markers", f"{_WORLDS}(name, ...): run the test once with each of these worlds")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a test once with each world of its marker."""
    mark = metafunc.definition.get_closest_marker(_WORLDS)
    if mark and "emulated_bench" in metafunc.fixturenames:
        worlds = [{"world": name} for name in mark.args]
        metafunc.parametrize("emulated_bench", worlds, ids=mark.args, indirect=True)


@pytest.fixture
def emulated_bench(request: pytest.FixtureRequest, tmp_path: Path) -> EmulatedBench:
    """The bench of the markers ``emulated_bench`` and ``worlds``, or of an indirect parameter (a dict)."""
    chosen = {"folder": tmp_path}
    for mark in reversed(list(request.node.iter_markers(_MARK))):  # the closest one last
        chosen |= mark.kwargs
    chosen |= getattr(request, "param", {})
    known = [each.name for each in fields(EmulatedBench)]
    if unknown := sorted(chosen.keys() - set(known)):
        raise pytest.UsageError(f"{_MARK}: unknown {unknown[0]!r}; allowed: {', '.join(known)}")
    return EmulatedBench(**chosen)  # type: ignore[arg-type]


@pytest.fixture
def run_procedure(request: pytest.FixtureRequest, emulated_bench: EmulatedBench) -> Callable[..., Run]:
    """Function that runs a procedure on the bench and returns a :class:`gyrobench.Run`.

    ``run_procedure(procedure, fail_on=None)`` raises what :func:`gyrobench.run` raises, MeasurementError if
    the run did not finish, or its unit is "rejected" or a dwell "flagged" where ``fail_on`` says so.
    """
    folders = request.node.stash.setdefault(_RUN_FOLDERS, [])

    def run_it(procedure: str | Path, *, fail_on: FailOn | None = None) -> Run:
        from gyrobench.bench.api import run
        from gyrobench.bench.foundations.errors import DocumentError, GyrobenchError
        from gyrobench.bench.foundations.shipped import find_document
        from gyrobench.bench.station.station import Station

        bench = emulated_bench
        if not Station(find_document("stations", bench.station)).file.is_emulated():
            raise DocumentError(
                f"{bench.station}: has instruments that are not emulated, which a test must not move. Name a "
                "station whose ports are emulator://"
            )
        folder = bench.folder / f"{Path(procedure).stem}-{len(folders) + 1}"
        folders.append(folder)
        try:
            return run(
                str(procedure),
                bench.station,
                world=bench.world,
                seed=bench.seed,
                faults=bench.faults,
                out=folder,
                fail_on=fail_on,
            )
        except GyrobenchError as error:
            __tracebackhide__ = True
            raise error.with_traceback(None) from None  # its text says all

    return run_it


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Show the journals of a test that failed."""
    report = yield
    if report.failed and report.when == "call":
        for folder in item.stash.get(_RUN_FOLDERS, []):
            report.sections.append((f"journal of {folder}", _journal(folder)))
    return report


def _journal(folder: Path) -> str:
    from gyrobench.bench.foundations.errors import GyrobenchError
    from gyrobench.bench.runs.journal import read_journal

    path = folder / "journal.jsonl"
    if not path.exists():
        return "The run did not begin."
    try:
        entries = list(read_journal(path))
    except GyrobenchError as error:
        return str(error)
    left_out = len(entries) - _MAX_ENTRIES
    head = [f"... {left_out} entries before"] if left_out > 0 else []
    return "\n".join([*head, *map(_line, entries[-_MAX_ENTRIES:])])


def _line(entry: dict[str, Any]) -> str:
    from gyrobench.bench.report.journal_sections import duration_text

    details = (f"{key}={value}" for key, value in entry.items() if key not in ("time_s", "utc", "event"))
    line = f"{duration_text(entry.get('time_s', 0.0)):>9}  {entry.get('event', '')}  {'  '.join(details)}"
    return line if len(line) <= _MAX_WIDTH else f"{line[:_MAX_WIDTH]} ..."
