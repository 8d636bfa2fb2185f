"""Check world files and lists of faults: ``python -m gyrobench.drivers.emulators.check_file check world W``.

The bench never reads these files itself: it runs this program to check a file or to get its JSON Schema.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from gyrobench.bench.foundations.documents import StrictModel, read_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.json_schema import json_schema
from gyrobench.drivers.emulators.faults.injector import FaultList
from gyrobench.drivers.emulators.world.world_file import WorldFile

_WRONG_FILE = 2
_KINDS: dict[str, tuple[type[StrictModel], str]] = {
    "world": (WorldFile, "gyrobench world behind emulated instruments"),
    "faults": (FaultList, "gyrobench list of faults"),
}


def main(arguments: list[str] | None = None) -> int:
    """Check a file, or print the JSON Schema of a kind of file; returns the exit code, 2 for a wrong file."""
    parser = argparse.ArgumentParser(
        prog="python -m gyrobench.drivers.emulators.check_file", description=__doc__
    )
    tasks = parser.add_subparsers(dest="task", required=True)
    for task, meaning in (("check", "check a file"), ("schema", "print a JSON Schema")):
        task_parser = tasks.add_parser(task, help=meaning)
        task_parser.add_argument("kind", choices=_KINDS)
        if task == "check":
            task_parser.add_argument("file", type=Path)
    options = parser.parse_args(arguments)
    model, title = _KINDS[options.kind]
    if options.task == "schema":
        sys.stdout.write(json.dumps(json_schema(model, title)) + "\n")
        return 0
    try:
        validate(read_document(options.file), model)
    except DocumentError as error:
        sys.stderr.write(f"{error}\n")
        return _WRONG_FILE
    return 0


if __name__ == "__main__":
    sys.exit(main())
