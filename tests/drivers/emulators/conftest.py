from collections.abc import Callable
from typing import Any

import pytest

from gyrobench.bench.foundations.documents import read_document
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.drivers.emulators.world.thermal import ChamberAir
from gyrobench.drivers.emulators.world.world import World
from gyrobench.drivers.emulators.world.world_file import WorldFile


def changed_world_file(name: str = "ideal", **sections: Any) -> WorldFile:
    """A shipped world with keys of some sections changed: ``ins={"boot_s": 1.0}``."""
    data = read_document(find_document("worlds", name)).data
    for section, value in sections.items():
        data[section] = data.get(section, {}) | value if isinstance(value, dict) else value
    return WorldFile.model_validate(data)


class ChamberPanel:
    """An emulated chamber with text commands, and the events that it switched."""

    def __init__(self, emulator: type, **options: Any) -> None:
        self.air, self.events = ChamberAir(), []
        self.chamber = emulator(self.air, lambda number, on: self.events.append((number, on)), **options)

    def ask(self, request: bytes) -> bytes:
        return self.chamber.feed(request, 1.0)


@pytest.fixture(scope="session")
def make_world_file() -> Callable[..., WorldFile]:
    return changed_world_file


@pytest.fixture(scope="session")
def make_world() -> Callable[..., World]:
    def make(name: str = "ideal", seed: int = 0, **sections: Any) -> World:
        return World(changed_world_file(name, **sections), seed)

    return make
