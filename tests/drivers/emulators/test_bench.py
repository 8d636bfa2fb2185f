import os
import subprocess
import sys

import pytest

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.kernels import Kernel
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.drivers.emulators.bench import EmulatedBench, compile_world
from gyrobench.drivers.emulators.world.world import INNER, OUTER

COMPILE = "from gyrobench.drivers.emulators.bench import compile_world; compile_world()"


def compiled():
    """Number of compiled signatures of each function of the emulators."""
    modules = [
        module for name, module in sys.modules.items() if name.startswith("gyrobench.drivers.emulators")
    ]
    functions = {each for module in modules for each in vars(module).values() if isinstance(each, Kernel)}
    return {f"{each.__module__}.{each.__name__}": len(each.dispatcher.signatures) for each in functions}


def test_a_bench_compiles_nothing_later():
    compile_world()
    before = compiled()
    assert sum(before.values()) > 10
    bench = EmulatedBench(VirtualClock(), find_document("worlds", "gyro_a"), 0)
    unit, clock = bench.world.unit, bench.clock
    bench.world.power_unit(True)
    for act in (
        lambda: None,
        unit.align,
        unit.navigate,
        unit.apply_compensation,
        lambda: bench.world.axes[INNER].move_to(90.0, clock.now()),
        lambda: bench.world.axes[OUTER].turn_at(-5.0, clock.now()),
        lambda: bench.ins.use_format("sbg"),
        lambda: bench.ins.use_format("canaerospace"),
        unit.standby,
    ):
        act()
        for step_s in (60.0, 0.013, 0.2):
            clock.sleep(step_s)
            bench.advance()
    assert compiled() == before


@pytest.mark.long
def test_the_first_bench_after_installation_reports_that_it_compiles(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", COMPILE]
    first, second = (
        subprocess.run(command, env=environment, capture_output=True, check=True).stderr for _ in range(2)
    )
    assert first.startswith(b"Compiling the simulated bench")
    assert b"Compiled the simulated bench in " in first
    assert second == b""
