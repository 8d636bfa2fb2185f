"""Faults that the emulators inject from a list, with their times, durations and repetitions.

A :class:`~.injector.FaultList` has one entry for each fault. The :class:`~.injector.Injector` schedules the
entries and executes them on the emulated bench, through wrappers around the emulators (:mod:`~.fault`).
Without a list there are no wrappers.
"""
