"""Drivers for the instruments of a gyro calibration bench.

One folder a class of instrument (:mod:`gyrobench.drivers.rate_table`, :mod:`gyrobench.drivers.chamber`,
:mod:`gyrobench.drivers.ins`): the interface that the bench uses, and one file for each dialect.
:mod:`gyrobench.drivers.emulators` holds a software emulator of each dialect, reached by its bytes alone.
"""
