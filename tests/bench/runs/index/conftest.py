"""One emulated run that all tests here copy."""

import pytest

from tests.bench.runs.index.sample_runs import emulated_run


@pytest.fixture(scope="session")
def sample(tmp_path_factory):
    """Path of a real run; not to be written in."""
    return emulated_run(tmp_path_factory.mktemp("sample"))
