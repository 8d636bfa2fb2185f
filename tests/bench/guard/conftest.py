import pytest

from tests.bench.guard.served_bench import ServedBench, SmallEngine


@pytest.fixture(autouse=True)
def lock_folder(tmp_path, monkeypatch):
    """Locks of the tests stay among themselves."""
    folder = tmp_path / "locks"
    folder.mkdir()
    monkeypatch.setenv("GYROBENCH_LOCK_DIR", str(folder))
    return folder


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    bench = ServedBench(tmp_path_factory.mktemp("bench"))
    yield bench
    bench.close()


@pytest.fixture
def start_engine(served, tmp_path):
    """Start engines in small; they are ended with the test."""
    engines = []

    def start(folder=tmp_path / "run"):
        engines.append(SmallEngine(served.station.path, folder))
        return engines[-1]

    yield start
    for engine in engines:
        engine.close()
