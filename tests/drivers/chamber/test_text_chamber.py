"""What chambers that are commanded by text have in common, whatever their dialect."""

import math

import pytest

from gyrobench.bench.foundations.errors import RefusedError
from gyrobench.drivers.chamber.thermotron_8800 import Thermotron8800
from gyrobench.drivers.chamber.watlow_f4t import WatlowF4T
from gyrobench.drivers.emulators.thermotron_8800 import Thermotron8800Emulator
from gyrobench.drivers.emulators.watlow_f4t import WatlowF4TEmulator
from tests.drivers.conftest import ChamberBench


class ThermotronBench(ChamberBench):
    emulator, driver_of = Thermotron8800Emulator, Thermotron8800


class WatlowBench(ChamberBench):
    emulator, driver_of = WatlowF4TEmulator, WatlowF4T


@pytest.fixture(params=[ThermotronBench, WatlowBench])
def bench(request, rig):
    return request.param(rig)


def test_there_is_no_query_for_its_limits(bench):
    with pytest.raises(RefusedError, match="read them from its panel"):
        bench.driver().limits_c()


@pytest.mark.parametrize(
    ("temperature_c", "rate"),
    [(math.nan, None), (math.inf, 1.0), (20.0, math.nan), (20.0, 0.0), (20.0, -1.0), (20.0, math.inf)],
)
def test_numbers_that_can_not_be_commanded_are_not_sent(bench, temperature_c, rate):
    chamber = bench.driver()
    bench.heard.requests.clear()
    with pytest.raises(RefusedError, match="can't be commanded"):
        chamber.set_temperature(temperature_c, rate)
    assert bench.heard.requests == []
