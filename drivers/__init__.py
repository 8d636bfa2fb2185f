"""Drivers for the instruments of a gyro calibration bench.

There is a folder for each class of instrument (:mod:`gyrobench.drivers.rate_table`,
:mod:`gyrobench.drivers.chamber`, :mod:`gyrobench.drivers.ins`) with the interface that the bench uses, and
one file for each dialect. :mod:`gyrobench.drivers.emulators` contains a software emulator of each dialect,
which can be reached only through its wire protocol.
"""
