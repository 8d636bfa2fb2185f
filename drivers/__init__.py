"""Drivers for the instruments of a gyro calibration bench.

One folder a class of instrument (:mod:`drivers.rate_table`, :mod:`drivers.chamber`,
:mod:`drivers.ins`): the interface that the bench uses, and one file for each dialect.
:mod:`drivers.emulators` holds a software emulator of each dialect, reached by its bytes alone.
"""
