import pytest

from tests.bench.exchange.made_up_log import MadeUpLog


@pytest.fixture
def log(tmp_path):
    return MadeUpLog(tmp_path)
