"""The error of a message that did not arrive."""

from __future__ import annotations

from gyrobench.bench.foundations.errors import GyrobenchError


class UndeliveredError(GyrobenchError):
    """A message could not be delivered.

    Parameters
    ----------
    message : str
        Why; without the secret.
    is_final : bool
        Whether trying again is no use: the receiver refused.
    """

    def __init__(self, message: str, is_final: bool) -> None:
        super().__init__(message)
        self.is_final = is_final
