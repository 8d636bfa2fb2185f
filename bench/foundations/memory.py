"""Memory of the process."""

from __future__ import annotations

import ctypes
import gc
from contextlib import suppress


def free_memory() -> None:
    """Free cycles of objects, and return memory to the system where its library can."""
    gc.collect()
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
