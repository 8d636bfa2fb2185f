"""gyrobench: bench controller for calibrating the gyros of inertial navigation systems.

>>> import gyrobench
>>> run = gyrobench.run("ten_minute_check", world="ideal")  # doctest: +SKIP
>>> run.dwells[["position", "bias_x_dph", "sigma_x_dph"]]  # doctest: +SKIP

Everything below is loaded when it is first used; see :mod:`gyrobench.bench.api`. The parts of the
package are folders at the top of the repository, bench/ and drivers/, and the YAML files for people.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gyrobench.bench import __version__
    from gyrobench.bench.api import Run, close_loop, estimate_bias, open_run, run

__all__ = ["Run", "__version__", "close_loop", "estimate_bias", "open_run", "run"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        return getattr(
            import_module("gyrobench.bench" if name == "__version__" else "gyrobench.bench.api"), name
        )
    raise AttributeError(f"module 'gyrobench' has no attribute '{name}'")


def __dir__() -> list[str]:
    return __all__
