"""The engine's process, held so that no other process can be mistaken for it."""

from __future__ import annotations

import contextlib
import os
import select
import signal


class EngineProcess:
    """The parent process, by a descriptor that stays with it even if its number is used again.

    Parameters
    ----------
    pid : int
        Its number, as it told itself.
    """

    def __init__(self, pid: int) -> None:
        self._descriptor: int | None = None
        if os.getppid() != pid:
            return
        descriptor = os.pidfd_open(pid)
        # While it still is the parent, the number could not have gone to another process before.
        if os.getppid() == pid:
            self._descriptor = descriptor
        else:
            os.close(descriptor)

    def ended(self, within_s: float = 0.0) -> bool:
        """Whether it has ended; waits for that."""
        if self._descriptor is None:
            return True
        ready, _, _ = select.select([self._descriptor], [], [], within_s)
        return bool(ready)

    def kill(self) -> None:
        """End it at once, also if it is stopped."""
        if self._descriptor is not None:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._descriptor, signal.SIGKILL)
