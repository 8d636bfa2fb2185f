"""What forked processes begin with: their modules imported, and the kernels of the emulated bench loaded."""

import tests.bench.guard.served_bench
import tests.bench.station.lock_holder  # noqa: F401
from gyrobench.drivers.emulators.serve import compile_world

compile_world()
