"""Kernels: compiled once, then loaded without the compiler, for themselves and for kernels compiled later."""

import os
import subprocess
import sys
from contextlib import ExitStack

import pytest

from gyrobench.bench.foundations.kernels import compiled

SOURCE = """
import sys
import numpy as np
from gyrobench.bench.foundations.kernels import Kernel, compiled, compiled_fastmath

assert "numba" not in sys.modules
from numba.core.codegen import CPUCodeLibrary

optimized = []
optimize = CPUCodeLibrary._optimize_final_module
CPUCodeLibrary._optimize_final_module = lambda library: [optimized.append(library), optimize(library)]

@compiled
def halves(values):
    total = 0.0
    for each in values:
        total += 0.5 * each
    return total

@compiled_fastmath
def twice(values):
    fours = np.empty(1)  # allocates
    fours[0] = 4.0
    return fours[0] * halves(values)

given = np.arange(4.0)
results = [kernel(given) for kernel in (halves, twice)[: int(sys.argv[1])]]
hits = sum(each.dispatcher.stats.cache_hits.total() for each in (halves, twice))
misses = Kernel.compilations()
print(results, hits, misses, "numba.np.arraymath" in sys.modules, bool(optimized))
"""


def used(folder, count, processes=1):
    """What new processes print that use ``count`` of the kernels at the same time."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache")}
    command = [sys.executable, str(folder / "kernels_to_use.py"), str(count)]
    with ExitStack() as started:
        users = [
            started.enter_context(
                subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
            )
            for _ in range(processes)
        ]
        return sorted(user.stdout.read().strip() for user in users)


def test_a_kernel_is_compiled_once_and_loaded_without_the_compiler(tmp_path):
    (tmp_path / "kernels_to_use.py").write_text(SOURCE)
    compiled_it, loaded = used(tmp_path, 1, processes=2)
    assert compiled_it == "[3.0] 0 1 True True"
    assert loaded.startswith("[3.0] 1 0 ")  # this one may have compiled numba's allocation of arrays
    assert used(tmp_path, 2, processes=2) == ["[3.0, 12.0] 1 1 True True", "[3.0, 12.0] 2 0 False False"]


def test_a_kernel_that_fails_to_compile_makes_no_other_wait():
    from numba import TypingError

    def wrong(value):
        return value.no_such_attribute

    for _ in range(2):
        with pytest.raises(TypingError):
            compiled(wrong)(1.0)


OTHER = """
import sys
import numba
import numpy as np
from gyrobench.bench.foundations import kernels

@numba.njit(cache=True)
def sorted_copy(values):
    return np.sort(values)

@numba.njit(cache=True)
def median(values):
    return sorted_copy(values)[len(values) // 2]

@kernels.compiled
def spread(values):
    return np.median(np.abs(values - median(values)))

given = np.arange(5.0)
if sys.argv[1] == "all":
    print(spread(given), median(given))
else:
    print(median(given), len(sorted_copy(given)))

@numba.njit
def later(values):
    return median(values) + len(sorted_copy(values))

print(later(given))
"""


@pytest.mark.long
def test_cached_code_of_other_packages_is_loaded_by_numba_in_its_way(tmp_path):
    script = tmp_path / "kernels_of_others.py"
    script.write_text(OTHER)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    for kernels, expected in (("all", "1.0 2.0 7.0"), ("all", "1.0 2.0 7.0"), ("few", "2.0 5 7.0")):
        done = subprocess.run(
            [sys.executable, str(script), kernels], env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout.split() == expected.split()
