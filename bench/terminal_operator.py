"""The operator at the terminal: asked there, answers there, while the run goes on ticking."""

from __future__ import annotations

import select
import sys
from collections.abc import Sequence

from rich.console import Console


class TerminalOperator:
    """Reads answers from standard input without waiting for them."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._answers: Sequence[str] = ()

    def ask(self, question: str, answers: Sequence[str]) -> None:
        """Print the question and the answers to choose from."""
        self._answers = answers
        self._console.print(f"\n{question}\nAnswer with one of: {', '.join(answers)}", soft_wrap=True)

    def answer(self) -> str | None:
        """The answer, once one of those asked for has been typed."""
        if sys.stdin is None or not select.select([sys.stdin], [], [], 0.0)[0]:
            return None
        typed = sys.stdin.readline().strip()
        if typed in self._answers:
            return typed
        if typed:
            self._console.print(f"Answer with one of: {', '.join(self._answers)}", soft_wrap=True)
        return None
