"""The candidate effects, one module each with an ``EFFECT``; other packages add theirs by entry point."""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import replace

from gyrobench.bench.closure.effects.effect import Effect, checked
from gyrobench.bench.foundations.entry_points import EFFECTS, installed, load
from gyrobench.bench.foundations.errors import DocumentError


def all_effects() -> tuple[Effect, ...]:
    """The effects of this package's modules and of other packages, by name.

    Raises
    ------
    DocumentError
        An effect of another package can't be imported, is no Effect, or has a name already used. It is
        not left out silently: the outcome of a search depends on its candidates.
    """
    modules = (importlib.import_module(f"{__name__}.{each.name}") for each in pkgutil.iter_modules(__path__))
    found = (getattr(module, "EFFECT", None) for module in modules)
    effects = {each.name: each for each in found if isinstance(each, Effect)}
    for name in installed(EFFECTS):
        effect = load(EFFECTS, name, Effect)
        if effect.name != name or name in effects:
            reason = (
                "is already used"
                if name in effects
                else f"differs from the name {effect.name!r} of its object"
            )
            raise DocumentError(
                f"the entry point {name!r} in {EFFECTS} {reason}. Report this to the package's author"
            )
        effects[name] = replace(effect, forms=tuple(checked(form, name) for form in effect.forms))
    return tuple(effects[name] for name in sorted(effects))
