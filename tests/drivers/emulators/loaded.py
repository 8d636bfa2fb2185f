"""What forked processes begin with: the emulated bench imported, and its kernels loaded."""

from gyrobench.drivers.emulators.serve import compile_world

compile_world()
