import pytest

from tests.bench.exchange.sample_log import SampleLog


@pytest.fixture
def log(tmp_path):
    return SampleLog(tmp_path)
