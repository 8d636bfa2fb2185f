"""The operator at the terminal: asked there, answers there, while the run goes on ticking."""

from __future__ import annotations

import select
import sys
from collections.abc import Sequence

from rich.console import Console

from bench.engine.orders import Order


class TerminalOperator:
    """Reads answers and orders from standard input without waiting for them."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._answers: Sequence[str] = ()

    def ask(self, question: str, answers: Sequence[str]) -> None:
        """Print the question and the answers to choose from."""
        self._answers = answers
        self._console.print(f"\n{question}\nAnswer with one of: {', '.join(answers)}", soft_wrap=True)

    def answer(self) -> str | None:
        """The answer, once one of those asked for has been typed."""
        typed = _typed()
        if typed in self._answers:
            self._answers = ()
            return typed
        if typed:
            self._console.print(f"Answer with one of: {', '.join(self._answers)}", soft_wrap=True)
        return None

    def withdraw(self) -> None:
        """Expect no answer any more."""
        self._answers = ()

    def order(self) -> Order | None:
        """An order that has been typed; other words are answered with what can be typed."""
        typed = "" if self._answers else _typed()
        if typed in list(Order):
            return Order(typed)
        if typed:
            self._console.print(f"Type one of: {', '.join(Order)}", soft_wrap=True)
        return None


def _typed() -> str:
    """A line that has been typed; empty if there is none."""
    try:
        if sys.stdin is None or sys.stdin.closed or not select.select([sys.stdin], [], [], 0.0)[0]:
            return ""
        return sys.stdin.readline().strip()
    except (OSError, ValueError):  # the terminal has gone
        return ""
