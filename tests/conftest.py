"""Order of the tests: those that wait in real time begin first, beside the others."""

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.get_closest_marker("wall_time") is None)
