"""Order of the tests, and which of them one worker runs."""

import pytest

SHIFT_RUNS = {"shift_runs", "watched_shift_runs"}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put tests that wait in real time first, and files that share runs into one worker."""
    items.sort(key=lambda item: item.get_closest_marker("wall_time") is None)
    sharing = {item.path for item in items if SHIFT_RUNS & set(getattr(item, "fixturenames", ()))}
    for item in items:
        group = "runs of a shift" if item.path in sharing else str(item.path)
        item.add_marker(pytest.mark.xdist_group(group))
