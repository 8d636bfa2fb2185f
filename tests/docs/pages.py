"""The pages of docs/ as the tests read them: commands, files and code in the order in which they stand."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"

#: What a comment above a block may say: the block is a file, or goes at the end of one.
_BLOCK = re.compile(
    r"(?:^% (?P<deed>file|append): (?P<name>\S+)\n\n?)?^```(?P<language>\w+)\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class Block:
    """A block of code of a page."""

    language: str
    text: str
    deed: str = ""
    name: str = ""

    def commands(self) -> list[list[str]]:
        """Commands of a console, each as a list of words."""
        lines = re.sub(r"\\\n\s*", "", self.text).splitlines()
        return [shlex.split(line.removeprefix("$ ")) for line in lines if line.startswith("$ ")]


def blocks(page: Path) -> Iterator[Block]:
    """All blocks of a page that name their language."""
    for found in _BLOCK.finditer(page.read_text(encoding="utf-8")):
        yield Block(found["language"], found["text"], found["deed"] or "", found["name"] or "")


def pages() -> list[Path]:
    """All pages, and the README."""
    return [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
