"""Order of the tests, which of them one worker runs, and where their locks are."""

import pytest

from bench.station.bench_lock import LOCK_DIR_VARIABLE

SHIFT_RUNS = {"shift_runs", "watched_shift_runs"}


@pytest.hookimpl(tryfirst=True)  # xdist reads the groups in the same hook
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put tests that wait in real time first, and files that share runs into one worker."""
    items.sort(key=lambda item: item.get_closest_marker("wall_time") is None)
    sharing = {item.path for item in items if SHIFT_RUNS & set(getattr(item, "fixturenames", ()))}
    for item in items:
        group = "runs of a shift" if item.path in sharing else str(item.path)
        item.add_marker(pytest.mark.xdist_group(group))


@pytest.fixture(scope="session", autouse=True)
def lock_folder_of_this_worker(tmp_path_factory):
    """Locks of the tests stay among those of one worker."""
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv(LOCK_DIR_VARIABLE, str(tmp_path_factory.mktemp("locks")))
        yield
