"""One vocabulary: plain technical English in code, messages, pages and YAML files."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SUFFIXES = {".py", ".md", ".yaml", ".j2", ".js", ".dbc", ".toml", ".cff"}
FOLDERS = (
    "bench",
    "drivers",
    "docs",
    "procedures",
    "stations",
    "worlds",
    "faults",
    "imports",
    "rotations",
    "conformance",
    "tests",
)

#: Words that an engineer would not write, as whole words and as parts of identifiers.
WORDS = (
    *("tell", "tells", "told", "telling", "anew", "nobody", "somebody", "whoever", "in vain", "for want of"),
    *("astray", "spoilt", "spoil", "spoils", "deaf", "obey", "obeys", "obeyed"),
)
#: Identifiers for which the vocabulary has another word.
IDENTIFIERS = (
    *("Audience", "People", "RunProgress", "Standing", "Orders", "Picture", "bench_now", "believed"),
    *("paid_with", "many_comparisons", "fit_test", "FitTest", "Hand"),
)
PREFIXES = ("_MOST_", "_LEAST_", "_LONGEST_", "_SHORTEST_", "MOST_", "LEAST_", "LONGEST_", "SHORTEST_")

#: Names of version 0.1.0 that are accepted with a note of what replaces them; and this list.
EXEMPT = {
    "bench/cli/control.py": {"tell"},
    "bench/cli/__init__.py": {"tell"},
    "tests/bench/cli/test_control.py": {"tell"},
    "tests/bench/cli/test_command_groups.py": {"tell"},
    "CHANGELOG.md": {"tell", "nobody"},
    "bench/station/interlocks.py": {"nobody"},
    "tests/bench/foundations/test_documents.py": {"nobody"},
    "tests/test_language.py": set(WORDS),
}


def texts() -> list[Path]:
    """Every file that a person reads, tests too."""
    tops = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", ROOT / "pyproject.toml"]
    below = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*"))]
    return tops + [path for path in below if path.suffix in SUFFIXES and path.is_file()]


def found_in(text: str, words: tuple[str, ...]) -> dict[int, str]:
    """Lines with one of the words, alone or as a part of an identifier in snake case."""
    lowered = text.lower()
    there = [word for word in words if word in lowered]
    if not there:
        return {}
    pattern = re.compile(rf"(?<![a-z])({'|'.join(there)})(?![a-z])", re.IGNORECASE)
    return {
        number: match[1].lower()
        for number, line in enumerate(text.splitlines(), 1)
        if (match := pattern.search(line))
    }


def test_no_archaic_or_private_words():
    wrong = []
    for path in texts():
        name = path.relative_to(ROOT).as_posix()
        for number, word in found_in(path.read_text(encoding="utf-8"), WORDS).items():
            if word not in EXEMPT.get(name, ()):
                wrong.append(f"{name}:{number}: {word}")
    assert not wrong, "\n".join(wrong)


def test_no_identifier_that_has_another_word():
    pattern = re.compile(rf"\b({'|'.join(IDENTIFIERS)})\b|\b({'|'.join(PREFIXES)})[A-Z]")
    wrong = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()[:80]}"
        for path in texts()
        if path.suffix == ".py" and path.name != "test_language.py"
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if pattern.search(line)
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("line", ["the journal tells", "def tell(run):", "is_deaf = True", "goes astray"])
def test_the_list_finds_words_in_sentences_and_identifiers(line):
    assert found_in(line, WORDS)


@pytest.mark.parametrize("line", ["intelligent", "satellite", "constellation", "stellar"])
def test_the_list_leaves_other_words_alone(line):
    assert not found_in(line, WORDS)
