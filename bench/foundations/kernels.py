"""Numerical kernels: functions that run as machine code.

Numba, which compiles them, is imported when the first one is called: it takes 0.2 s and 50 MB, and most
processes import kernels without calling any.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial, update_wrapper
from typing import Any, ClassVar, Generic, ParamSpec, TypeVar, overload

from gyrobench.bench.foundations.arrays import FloatArray

_P = ParamSpec("_P")
_R = TypeVar("_R")


class Kernel(Generic[_P, _R]):
    """Function whose machine code is compiled, or loaded from numba's cache, at its first call."""

    _called: ClassVar[list[Kernel[Any, Any]]] = []

    def __init__(self, function: Callable[_P, _R], *, fastmath: bool) -> None:
        self._function, self._fastmath = function, fastmath
        update_wrapper(self, function)

    def __call__(self, *args: _P.args, **kwargs: _P.kwargs) -> _R:
        """Run it; some 0.1 us longer than numba's own function takes."""
        return self.dispatcher(*args, **kwargs)  # type: ignore[no-any-return]

    @cached_property
    def dispatcher(self) -> Any:
        """Numba's function behind it."""
        from gyrobench.bench.foundations.machine_code import dispatcher

        self._called.append(self)
        return dispatcher(self._function, fastmath=self._fastmath)

    @property
    def _numba_type_(self) -> Any:
        """Numba asks for it when it compiles a kernel that calls this one."""
        return self.dispatcher._numba_type_

    @classmethod
    def compilations(cls) -> int:
        """How many this process had to compile, since numba's cache did not have them."""
        return sum(sum(each.dispatcher.stats.cache_misses.values()) for each in cls._called)


@overload
def compiled(function: Callable[_P, _R]) -> Kernel[_P, _R]: ...


@overload
def compiled(*, fastmath: bool) -> Callable[[Callable[_P, _R]], Kernel[_P, _R]]: ...


def compiled(function: Any = None, *, fastmath: bool = False) -> Any:
    """Decorator of kernels; ``fastmath`` lets the compiler reorder sums."""
    return partial(Kernel, fastmath=fastmath) if function is None else Kernel(function, fastmath=fastmath)


@compiled
def set_product(product: FloatArray, a: FloatArray, b: FloatArray) -> None:
    """Set ``product`` (3, 3), neither of the others, to that of two matrices."""
    for i in range(3):
        for j in range(3):
            product[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
