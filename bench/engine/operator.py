"""The person at the bench, as the engine sees one."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Protocol


class Operator(Protocol):
    """Somebody who can be asked; the run goes on ticking until the answer is there."""

    def ask(self, question: str, answers: Sequence[str]) -> None:
        """Put a question; the answer comes later."""
        ...

    def answer(self) -> str | None:
        """Return the answer, or None while there is none."""
        ...


class ConsentingOperator:
    """Gives the first answer at once: for emulated benches, where nobody sits."""

    def __init__(self) -> None:
        self._answer = ""

    def ask(self, question: str, answers: Sequence[str]) -> None:  # noqa: ARG002
        """Settle on the first answer."""
        self._answer = answers[0]

    def answer(self) -> str | None:
        """The first answer."""
        return self._answer


def asked(operator: Operator, question: str, answers: Sequence[str]) -> Generator[None, None, str]:
    """Put a question and yield once a tick until it is answered; returns the answer."""
    operator.ask(question, answers)
    while (answer := operator.answer()) is None:
        yield
    return answer
