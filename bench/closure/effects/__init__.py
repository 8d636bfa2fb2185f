"""The candidate effects: each module of this package that has an ``EFFECT`` adds one."""

from __future__ import annotations

import importlib
import pkgutil

from gyrobench.bench.closure.effects.effect import Effect


def all_effects() -> tuple[Effect, ...]:
    """Find the effects of this package's modules, by name."""
    modules = (importlib.import_module(f"{__name__}.{each.name}") for each in pkgutil.iter_modules(__path__))
    found = (getattr(module, "EFFECT", None) for module in modules)
    return tuple(sorted((each for each in found if isinstance(each, Effect)), key=lambda effect: effect.name))
