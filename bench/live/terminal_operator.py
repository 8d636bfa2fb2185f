"""The operator at the terminal: asked there, answers there, while the run goes on ticking."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console

from gyrobench.bench.engine.operator import RunCommand
from gyrobench.bench.live.keyboard import Keyboard


class TerminalOperator:
    """Takes answers and orders from the keyboard without waiting for them."""

    def __init__(self, console: Console, keyboard: Keyboard) -> None:
        self._console = console
        self._keyboard = keyboard
        self._answers: Sequence[str] = ()

    def ask(self, question: str, answers: Sequence[str]) -> None:
        """Print the question and the answers to choose from."""
        self._answers = answers
        self._console.print(f"\n{question}\nAnswer with one of: {', '.join(answers)}", soft_wrap=True)

    def answer(self) -> str | None:
        """The answer, once one of those asked for has been typed."""
        typed = self._keyboard.line()
        if typed in self._answers:
            self._answers = ()
            return typed
        if typed:
            self._console.print(f"Answer with one of: {', '.join(self._answers)}", soft_wrap=True)
        return None

    def withdraw(self) -> None:
        """Expect no answer any more."""
        self._answers = ()

    def order(self) -> RunCommand | None:
        """An order that has been typed; other words are answered with what can be typed."""
        typed = "" if self._answers else self._keyboard.line()
        if typed in list(RunCommand):
            return RunCommand(typed)
        if typed:
            self._console.print(f"Type one of: {', '.join(RunCommand)}", soft_wrap=True)
        return None
