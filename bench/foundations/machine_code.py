"""Compiles kernels with numba once, caches their machine code, and loads it without the compiler."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
from numba.core import environment
from numba.core.caching import Cache, FunctionCache, make_library_cache
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher
from numba.core.runtime import nrtdynmod
from numba.core.runtime.nrt import rtsys

#: The classes below are tested with this version of numba; any other version uses its own caching.
_IS_TESTED = numba.version_info.short == (0, 68)


class _LightCache(Cache):
    """Cache that loads code without numba's compiler, which takes 0.3 s and 60 MB in each process.

    If the code is not cached, one process compiles it while others that need it wait.
    """

    _lock: int | None = None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        overload = self._try_load(sig, target_context)
        if overload is None and self._lock is None:
            with suppress(ImportError, OSError):
                import fcntl

                self._impl.locator.ensure_cache_path()
                path = Path(self.cache_path, f"{self._impl.filename_base}.lock")
                self._lock = os.open(path, os.O_CREAT | os.O_RDWR)
                fcntl.flock(self._lock, fcntl.LOCK_EX)
            overload = self._try_load(sig, target_context)
        return overload

    def _try_load(self, sig: Any, target_context: Any) -> Any:
        # Code that another version of this module stored is compiled again.
        with self._guard_against_spurious_io_errors(), suppress(AttributeError, ImportError):
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        return None

    def release(self) -> None:
        """Release the lock: the code is in the cache, or can't be compiled."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


class _MachineCode(_LightCache, FunctionCache):
    def load_overload(self, sig: Any, target_context: Any) -> Any:
        rtsys.initialize(target_context)
        return super().load_overload(sig, target_context)


class _Library(_LightCache, make_library_cache("library")):  # type: ignore[misc]
    """Cache of code that all kernels use."""


def _array_allocation(target_context: Any) -> Any:
    """Load numba's functions that allocate arrays from the cache too; saves 20 MB in each process."""
    cache = _Library(_array_allocation)  # type: ignore[no-untyped-call]
    try:
        library = cache.load_overload((), target_context)
        if library is None:
            module, library = nrtdynmod.create_nrt_module(target_context)  # type: ignore[no-untyped-call]
            library.enable_object_caching()
            library.add_ir_module(module)
            library.finalize()
            cache.save_overload((), library)  # type: ignore[no-untyped-call]
    finally:
        cache.release()
    return library


def _environment(module: str, constants: Any, name: str) -> Any:
    """Environment of loaded code; without globals, so that numba's modules for them are not imported."""
    loaded = environment.lookup_environment(name)  # type: ignore[no-untyped-call]
    if loaded is None:
        loaded = environment.Environment({"__name__": module})
        loaded.consts[:], loaded.env_name = constants, name
        environment.Environment._memo[name] = loaded  # noqa: SLF001
    return loaded


if _IS_TESTED:
    nrtdynmod.compile_nrt_functions = _array_allocation
    environment._rebuild_env = _environment  # noqa: SLF001


class _Dispatcher(CPUDispatcher):
    def enable_caching(self) -> None:
        self._cache = _MachineCode(self.py_func)  # type: ignore[no-untyped-call]

    def compile(self, sig: Any) -> Any:
        try:
            return super().compile(sig)
        finally:
            self._cache.release()


def dispatcher(function: Callable[..., Any], *, fastmath: bool) -> Dispatcher[Any]:
    """Return a function that is compiled for the types of its arguments, or loaded from the cache."""
    if not _IS_TESTED:
        return numba.njit(fastmath=fastmath, cache=True)(function)
    kernel = _Dispatcher(function, targetoptions={"nopython": True, "fastmath": fastmath})
    kernel.enable_caching()
    return kernel
