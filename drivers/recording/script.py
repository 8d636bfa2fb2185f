"""A recording as the other side of a line: it answers as recorded, and only to what was asked then."""

from __future__ import annotations

from gyrobench.drivers.recording.document import Recording, Transfer

#: A driver is never asked to keep time to better than this: what should have come by then has come.
_TOLERANCE_S = 0.05


class ReplayError(Exception):
    """The driver asks something else than it did when it was recorded, or earlier."""


class ReplayScript:
    """What is left of a recording.

    A reply comes as long after the question before it as it did then.

    Parameters
    ----------
    now_s : float
        Time at which the line is opened, on the clock that the other calls are told.
    """

    def __init__(self, recording: Recording, now_s: float) -> None:
        self._path = recording.path
        self._left = list(reversed(recording.transfers))
        self._zero_s = now_s
        self._asked = b""

    @property
    def next_due_s(self) -> float | None:
        """When the next bytes arrive; None while the instrument waits to be asked."""
        if not self._left or self._left[-1].is_sent:
            return None
        return self._zero_s + self._left[-1].time_s

    def arrived(self, now_s: float) -> bytes:
        """Bytes that have come by now, since the last call."""
        data = b""
        while (due_s := self.next_due_s) is not None and due_s <= now_s:
            data += self._left.pop().data
        return data

    def ask(self, data: bytes, now_s: float) -> None:
        """Take what the driver sends.

        Raises
        ------
        ReplayError
            It is not what was sent then; the message has the place in the recording, and both.
        """
        self._let_pass(now_s)
        asked = self._asked + data
        while asked:
            if not self._left:
                raise ReplayError(f"{self._path}: the recording is at its end, and got {_shown(asked)}")
            expected = self._left[-1]
            if not expected.is_sent:
                raise self._too_early(expected, asked)
            if not (expected.data.startswith(asked) or asked.startswith(expected.data)):
                raise ReplayError(
                    f"{self._path}:{expected.line}: expected {_shown(expected.data)}; got {_shown(asked)}"
                )
            if len(asked) < len(expected.data):
                break
            asked = asked[len(expected.data) :]
            self._left.pop()
            self._zero_s = now_s - expected.time_s
        self._asked = asked

    def _let_pass(self, now_s: float) -> None:
        """Skip what the driver did not wait for by no more than a recording's times are good for."""
        while (due_s := self.next_due_s) is not None and due_s <= now_s + _TOLERANCE_S:
            self._left.pop()

    def _too_early(self, expected: Transfer, asked: bytes) -> ReplayError:
        return ReplayError(
            f"{self._path}:{expected.line}: asks {_shown(asked)} before the reply "
            f"{_shown(expected.data)} has come"
        )


def _shown(data: bytes) -> str:
    return f"{data.hex(' ')} ({data.decode('ascii', 'backslashreplace')!r})"
