"""Software emulators of the instruments, reached through the real interfaces.

Three layers, each in separate files: the physics of the bench (:mod:`gyrobench.drivers.emulators.world`),
the state machine and wire protocol of each instrument (one file for each dialect), and the access to them
(a pyserial URL, a python-can interface, or a separate process).
"""
