"""Faults that the emulators inject from a list: what fails, when, for how long and how often.

A :class:`~.injector.FaultList` has one entry a fault. The :class:`~.injector.Injector` schedules the
entries and carries them out on the emulated bench, through wrappers around the real emulators
(:mod:`~.fault`). Without a list no wrapper exists.
"""
