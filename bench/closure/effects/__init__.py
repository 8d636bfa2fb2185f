"""The candidate effects: from the modules here, entry points of other packages, and files of the user."""

from __future__ import annotations

import importlib
import pkgutil
import re
from collections.abc import Mapping
from pathlib import Path

from gyrobench.bench.closure.effects.effect import Effect, checked
from gyrobench.bench.closure.effects.effect_file import effect_folders, read_effects
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.packages import EFFECTS, installed, load


def all_effects(*sources: Path, sensor: str = "gyro") -> tuple[Effect, ...]:
    """The effects of this package's modules, of other packages and of the user's files, by name.

    ``sensor``: "gyro" or "accelerometer", the sensors searched. ``sources``: the tables or runs searched; see
    :func:`gyrobench.bench.closure.effects.effect_file.effect_folders`. Raises DocumentError if an effect of
    another package can't be imported, is not an Effect, or has a name already used, or if a file is wrong. No
    effect is omitted silently, since the outcome of a search depends on its candidates.
    """
    modules = (importlib.import_module(f"{__name__}.{each.name}") for each in pkgutil.iter_modules(__path__))
    built_in = (each for module in modules for each in vars(module).values() if isinstance(each, Effect))
    effects = {each.name: each for each in built_in}
    for name in installed(EFFECTS):
        effect = load(EFFECTS, name, Effect)
        reason = _problem_of(effect, name, effects)
        if reason:
            raise DocumentError(
                f"the entry point {name!r} in {EFFECTS} {reason}. Report this to the package's author"
            )
        effects[name] = checked(effect)
    for path, effect in read_effects(effect_folders(sources)):
        if effect.name in effects:
            raise DocumentError(f"{path}: another effect is called {effect.name}. Choose another name")
        effects[effect.name] = checked(effect)
    return tuple(effects[name].seen_by(sensor) for name in sorted(effects) if sensor in effects[name].sensors)


def _problem_of(effect: Effect, entry: str, effects: Mapping[str, Effect]) -> str:
    if entry in effects:
        return "has the name of another effect"
    if effect.name != entry:
        return f"differs from the name {effect.name!r} of its object"
    return "" if re.fullmatch("[a-z0-9_]{1,60}", entry) else "has characters other than a-z, 0-9 and _"
