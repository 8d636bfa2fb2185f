"""A process of limited memory that reads inputs one after the other and reports each on standard output."""

from __future__ import annotations

import contextlib
import json
import logging
import re
import resource
import shutil
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random

from gyrobench.bench.foundations.errors import GyrobenchError
from tests.fuzz.sandbox import HangError, Sandbox
from tests.fuzz.targets import Target, finished_run, targets

MEMORY_BYTES = 4 << 30
#: Most that an input may take of the processor; on a busy machine more time passes.
WORK_S, WAIT_S = 20.0, 600.0


@dataclass(frozen=True)
class Work:
    """What a worker has to do.

    Attributes
    ----------
    count, seed : int
        How many inputs there are in all, and what they follow from.
    kinds : sequence of str
        Kinds of file; all where empty.
    only_input : int or None
        The one number of an input of each kind; None for all.
    first, step : int
        The first input that is this worker's, and how far apart its inputs are.
    keep : Path or None
        Folder for inputs that are a problem.
    """

    count: int
    seed: int
    kinds: Sequence[str]
    only_input: int | None
    first: int
    step: int
    keep: Path | None


def do(work: Work, shared: Path) -> None:
    """Read the inputs; ``shared`` is a folder that outlives the process, so that its run is made once."""
    logging.disable()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder, contextlib.chdir(folder):
        kinds = targets(finished_run(shared))
        sandbox = Sandbox()
        home = Path(folder) / "input"
        warm: set[str] = set()
        inputs = _inputs(kinds, work)
        for place in range(work.first, len(inputs), work.step):
            kind, number = inputs[place]
            if kind not in warm:
                warm.add(kind)
                _warm_up(kinds[kind], home)
            _report({"place": place, "kind": kind, "number": number})
            data = kinds[kind].input(random_of(work.seed, kind, number))
            kept = work.keep / f"{kind.replace(' ', '_')}_{number}" if work.keep else None
            if kept:
                kept.write_bytes(data)  # before it is read, which may be the end of this process
            outcome = _outcome(kinds[kind], home, data, sandbox)
            if kept and outcome["outcome"] != "problem":
                kept.unlink(missing_ok=True)
            _report(outcome)


def random_of(seed: int, kind: str, number: int) -> Random:
    """What is random in an input."""
    return Random(f"{seed}/{kind}/{number}")  # noqa: S311 - made for repeating, not for hiding


def _inputs(kinds: Mapping[str, Target], work: Work) -> list[tuple[str, int]]:
    """Kind and number of each input."""
    shares = sum(target.share for target in kinds.values())
    inputs = []
    for kind, target in kinds.items():
        if not work.kinds or kind in work.kinds:
            count = max(1, round(work.count * target.share / shares))
            numbers = range(count) if work.only_input is None else (work.only_input,)
            inputs += [(kind, number) for number in numbers]
    return inputs


def _warm_up(target: Target, home: Path) -> None:
    """What is read for the first time is imported and compiled; that is no work of an input's."""
    for data in {target.base[0], target.base[-1]}:
        _remade(home)
        with contextlib.suppress(GyrobenchError):
            target.use(home, data)


def _remade(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()


def _report(what: Mapping[str, object]) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def _outcome(target: Target, home: Path, data: bytes, sandbox: Sandbox) -> dict[str, str]:
    _remade(home)
    unraised: list[str] = []
    try:
        with _strictly(unraised), sandbox.inside(home, WORK_S, WAIT_S):
            target.use(home, data)
        outcome = {"outcome": "accepted"}
    except GyrobenchError as error:
        outcome = {"outcome": "refused", "why": str(error)}
        if not re.search(target.place, str(error)):
            outcome = _problem(f"the message names no place: {type(error).__name__}: {error!s:.300}")
    except HangError:
        outcome = _problem(f"more than {WORK_S:g} s of the processor, or {WAIT_S:g} s")
    except Exception as error:  # noqa: BLE001 - any other exception is what the fuzzer looks for
        places = traceback.extract_tb(error.__traceback__)
        where = " < ".join(f"{Path(each.filename).name}:{each.lineno}" for each in reversed(places[-6:]))
        outcome = _problem(f"{type(error).__name__}: {error!s:.200} ({where})")
    if sandbox.broken:
        outcome = _problem(f"touched the machine: {'; '.join(sandbox.broken[:3])}")
    elif unraised:
        outcome = _problem(f"could not be raised: {'; '.join(unraised[:3])}")
    return outcome


def _problem(why: str) -> dict[str, str]:
    return {"outcome": "problem", "why": why}


@contextlib.contextmanager
def _strictly(unraised: list[str]) -> Iterator[None]:
    """Make warnings errors, and note what Python or a library could only have printed."""
    sys.unraisablehook = lambda raised: unraised.append(
        f"{raised.exc_value!r:.200} in {raised.object!r:.100}"
    )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    finally:
        sys.unraisablehook = sys.__unraisablehook__
