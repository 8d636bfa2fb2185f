"""Software emulators of the instruments, behind their real interfaces.

Three layers, each in its own files: the physics of the bench (:mod:`gyrobench.drivers.emulators.world`),
each instrument's state machine and wire protocol (one file a dialect), and the ways to reach
them (a pyserial URL, a python-can interface, or separate processes).
"""
