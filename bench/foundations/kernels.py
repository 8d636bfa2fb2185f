"""Numerical kernels: functions as machine code, compiled once by numba and cached in the user's folder."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar, overload

import numba
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher
from numba.core.runtime.nrt import rtsys

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])


class _MachineCode(FunctionCache):
    """Loads code without all that numba needs to compile any: 0.3 s and 60 MB in each process."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]


@overload
def compiled(function: FunctionT) -> Dispatcher[FunctionT]: ...


@overload
def compiled(*, fastmath: bool) -> Callable[[FunctionT], Dispatcher[FunctionT]]: ...


def compiled(function: Any = None, *, fastmath: bool = False) -> Any:
    """Decorator of kernels; ``fastmath`` lets the compiler reorder sums."""
    if function is None:
        return partial(compiled, fastmath=fastmath)
    kernel = numba.njit(fastmath=fastmath)(function)
    kernel._cache = _MachineCode(function)  # type: ignore[attr-defined,no-untyped-call]  # noqa: SLF001
    return kernel
