"""Numerical kernels: functions that numba compiles to machine code.

Numba is imported when the first kernel is called: it takes 0.2 s and 50 MB, and most processes import kernels
without calling any.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, update_wrapper
from typing import Any, ClassVar, Generic, ParamSpec, TypeVar

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray

_P = ParamSpec("_P")
_R = TypeVar("_R")


class Kernel(Generic[_P, _R]):
    """A function that is compiled, or loaded from numba's cache, at its first call."""

    _called: ClassVar[list[Kernel[Any, Any]]] = []

    def __init__(self, function: Callable[_P, _R], *, fastmath: bool) -> None:
        self._function, self._fastmath = function, fastmath
        update_wrapper(self, function)

    def __call__(self, *args: _P.args, **kwargs: _P.kwargs) -> _R:
        """Call the compiled function; takes some 0.1 us longer than numba's dispatcher."""
        return self.dispatcher(*args, **kwargs)  # type: ignore[no-any-return]

    @cached_property
    def dispatcher(self) -> Any:
        """Numba's dispatcher of the function."""
        from gyrobench.bench.foundations.machine_code import dispatcher

        self._called.append(self)
        return dispatcher(self._function, fastmath=self._fastmath)

    @property
    def _numba_type_(self) -> Any:
        """Type of the dispatcher; numba reads it when it compiles a kernel that calls this one."""
        return self.dispatcher._numba_type_

    @classmethod
    def compilations(cls) -> int:
        """Number of functions that this process compiled because they were not in numba's cache."""
        return sum(sum(each.dispatcher.stats.cache_misses.values()) for each in cls._called)


def compiled(function: Callable[_P, _R]) -> Kernel[_P, _R]:
    """Decorate a function as a kernel."""
    return Kernel(function, fastmath=False)


def compiled_fastmath(function: Callable[_P, _R]) -> Kernel[_P, _R]:
    """Decorate a function as a kernel in which the compiler may reorder sums."""
    return Kernel(function, fastmath=True)


@compiled
def multiply_3x3(product: FloatArray, a: FloatArray, b: FloatArray) -> None:
    """Write the product of two matrices (3, 3) to ``product``, which must be a different array."""
    for i in range(3):
        for j in range(3):
            product[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@compiled
def copy_matrix(target: FloatArray, source: FloatArray) -> None:
    """Copy a matrix to the upper left of ``target``; numba takes seconds to compile such an assignment."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]


@compiled
def follow_with_play(values: FloatArray, half_widths: FloatArray, first: FloatArray) -> FloatArray:
    """Followers (k, m) with play: each moves when its quantity is a half width (k,) ahead of it.

    ``values`` (k, m): courses of the quantities. ``first`` (k,): positions before the first instant.
    """
    followers = np.empty_like(values)
    for row in range(values.shape[0]):
        follower, half_width = first[row], half_widths[row]
        for index in range(values.shape[1]):
            value = values[row, index]
            if value != value or follower < value - half_width:  # NaN stays
                follower = value - half_width
            elif follower > value + half_width:
                follower = value + half_width
            followers[row, index] = follower
    return followers
