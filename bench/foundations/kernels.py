"""Numerical kernels: functions as machine code, compiled once by numba and cached in the user's folder."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, overload

import numba
from numba.core import environment
from numba.core.caching import Cache, FunctionCache, make_library_cache
from numba.core.dispatcher import Dispatcher
from numba.core.runtime import nrtdynmod
from numba.core.runtime.nrt import rtsys

from gyrobench.bench.foundations.arrays import FloatArray

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])

#: The classes below are tested with this version of numba; any other caches in its usual way.
_IS_TESTED = numba.version_info.short == (0, 68)


class _LoadedAlone(Cache):
    """Loads code without all that numba needs to compile any: 0.3 s and 60 MB in each process.

    What is not there yet one process compiles, while others that need it wait.
    """

    _lock: int | None = None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = self._loaded(sig, target_context)
        if found is None and self._lock is None:
            with suppress(ImportError, OSError):
                import fcntl

                self._impl.locator.ensure_cache_path()
                path = Path(self.cache_path, f"{self._impl.filename_base}.lock")
                self._lock = os.open(path, os.O_CREAT | os.O_RDWR)
                fcntl.flock(self._lock, fcntl.LOCK_EX)
            found = self._loaded(sig, target_context)
            if found is not None:
                self._release()
        return found

    def _loaded(self, sig: Any, target_context: Any) -> Any:
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]

    def save_overload(self, sig: Any, data: Any) -> None:
        super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        self._release()

    def _release(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


class _MachineCode(_LoadedAlone, FunctionCache):
    def load_overload(self, sig: Any, target_context: Any) -> Any:
        rtsys.initialize(target_context)
        return super().load_overload(sig, target_context)


class _Library(_LoadedAlone, make_library_cache("library")):  # type: ignore[misc]
    """Code that belongs to no single kernel."""


def _array_allocation(target_context: Any) -> Any:
    """Numba's functions that allocate arrays, also from the cache: 20 MB less in each process."""
    cache = _Library(_array_allocation)  # type: ignore[no-untyped-call]
    library = cache.load_overload((), target_context)
    if library is None:
        module, library = nrtdynmod.create_nrt_module(target_context)  # type: ignore[no-untyped-call]
        library.enable_object_caching()
        library.add_ir_module(module)
        library.finalize()
        cache.save_overload((), library)
    return library


def _environment(module: str, constants: Any, name: str) -> Any:
    """Environment of loaded code. It reads no globals, so the modules of numba behind it are not imported."""
    found = environment.lookup_environment(name)  # type: ignore[no-untyped-call]
    if found is None:
        found = environment.Environment({"__name__": module})
        found.consts[:], found.env_name = constants, name
        environment.Environment._memo[name] = found  # noqa: SLF001
    return found


if _IS_TESTED:
    nrtdynmod.compile_nrt_functions = _array_allocation
    environment._rebuild_env = _environment  # noqa: SLF001


@overload
def compiled(function: FunctionT) -> Dispatcher[FunctionT]: ...


@overload
def compiled(*, fastmath: bool) -> Callable[[FunctionT], Dispatcher[FunctionT]]: ...


def compiled(function: Any = None, *, fastmath: bool = False) -> Any:
    """Decorator of kernels; ``fastmath`` lets the compiler reorder sums."""
    if function is None:
        return partial(compiled, fastmath=fastmath)
    kernel = numba.njit(fastmath=fastmath, cache=not _IS_TESTED)(function)
    if _IS_TESTED:
        kernel._cache = _MachineCode(function)  # type: ignore[attr-defined,no-untyped-call]  # noqa: SLF001
    return kernel


@compiled
def set_product(product: FloatArray, a: FloatArray, b: FloatArray) -> None:
    """Set ``product`` (3, 3), neither of the others, to that of two matrices."""
    for i in range(3):
        for j in range(3):
            product[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
