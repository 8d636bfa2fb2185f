"""The person at the bench, as the engine sees one."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Protocol

from gyrobench.bench.engine.orders import Order


class Operator(Protocol):
    """Somebody who can be asked; the run goes on ticking until the answer is there."""

    def ask(self, question: str, answers: Sequence[str]) -> None:
        """Put a question; the answer comes later."""
        ...

    def answer(self) -> str | None:
        """Return the answer, or None while there is none."""
        ...

    def withdraw(self) -> None:
        """Withdraw the question: it has answered itself."""
        ...

    def order(self) -> Order | None:
        """Return an order given without being asked, or None; not while a question is open."""
        ...


class ConsentingOperator:
    """Gives the first answer at once, for emulated benches, where nobody sits.

    Parameters
    ----------
    patience : int
        How often it answers one question in a row before it gives the last answer instead: what is wrong
        with an emulated bench passes by itself or never.
    """

    def __init__(self, patience: int = 30) -> None:
        self._patience = patience
        self._asked: tuple[str, int] = ("", 0)
        self._answer = ""

    def ask(self, question: str, answers: Sequence[str]) -> None:
        """Settle on an answer."""
        before, times = self._asked
        self._asked = (question, times + 1 if question == before else 1)
        self._answer = answers[0] if self._asked[1] <= self._patience else answers[-1]

    def answer(self) -> str | None:
        """The answer."""
        return self._answer

    def withdraw(self) -> None:
        """Nothing is open."""

    def order(self) -> Order | None:
        """None ever: it only consents."""
        return None


def asked(operator: Operator, question: str, answers: Sequence[str]) -> Generator[None, None, str]:
    """Put a question and yield once a tick until it is answered; returns the answer."""
    operator.ask(question, answers)
    try:
        while (answer := operator.answer()) is None:
            yield
    finally:
        operator.withdraw()  # also where something else ends the waiting
    return answer
