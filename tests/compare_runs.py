"""Compare the tables of two run folders, digit for digit: ``python -m tests.compare_runs OLD NEW``.

For a change that must not change what is computed: run one procedure with one seed before and after it.
Every number of the dwell table, the bins, the joint solutions, the noise, the acceptance and the closure is
compared as it is written; names of columns and keys, and texts, may differ, and are listed. Exit code 1 where
a number differs.
"""

import csv
import json
import sys
from collections.abc import Iterator
from pathlib import Path

TABLES = ("dwells.csv", "bias_bins.csv", "joint.csv", "joint_biases.csv", "closure/predictions.csv")
DOCUMENTS = ("noise.json", "acceptance.json", "closure/closure.json")


def numbers_of_table(path: Path) -> Iterator[tuple[str, str]]:
    """Place and text of every number, column by column."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    for index, name in enumerate(header):
        for row, cells in enumerate(rows):
            if _is_number(cells[index]):
                yield f"{name}[{row}]", cells[index]


def numbers_of_document(value: object, place: str = "") -> Iterator[tuple[str, str]]:
    """Place and text of every number below a JSON value."""
    if isinstance(value, dict):
        for key, below in value.items():
            yield from numbers_of_document(below, f"{place}.{key}")
    elif isinstance(value, list):
        for index, below in enumerate(value):
            yield from numbers_of_document(below, f"{place}[{index}]")
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield place, repr(value)


def differences(before: Path, after: Path) -> Iterator[tuple[bool, str]]:
    """Everything that differs: whether it is a number, and a line for a person."""
    for name in (*TABLES, *DOCUMENTS):
        one, other = before / name, after / name
        if not (one.exists() and other.exists()):
            if one.exists() or other.exists():
                yield False, f"{name}: only in {one.parent if one.exists() else other.parent}"
            continue
        read = numbers_of_table if name.endswith(".csv") else _numbers_of_file
        first, second = list(read(one)), list(read(other))
        if len(first) != len(second):
            yield True, f"{name}: {len(first)} numbers before, {len(second)} after"
        for (place, value), (new_place, new_value) in zip(first, second, strict=False):
            if value != new_value:
                yield True, f"{name}: {place}: {value} before, {new_value} after"
            is_repeated = place.endswith("]") and not place.endswith("[0]")
            if place != new_place and not is_repeated:
                yield False, f"{name}: {place} is called {new_place}"


def _numbers_of_file(path: Path) -> Iterator[tuple[str, str]]:
    return numbers_of_document(json.loads(path.read_text(encoding="utf-8")))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def main() -> int:
    """Print the differences; returns the exit code."""
    before, after = map(Path, sys.argv[1:])
    found = list(differences(before, after))
    for _, line in found[:100]:
        print(line)
    wrong = sum(is_number for is_number, _ in found)
    differ = "number differs" if wrong == 1 else "numbers differ"
    print(f"{wrong} {differ}" if wrong else "every number is the same to the last digit")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
