"""Faults that the emulators inject: what, when, for how long, how often.

A list of faults (:mod:`document`) is one entry a fault. Its :class:`~.timing.Timing` says when, a
:class:`~.schedule.Schedule` works that out, and the :class:`~.injector.Injector` carries it out on
the emulated bench, through wrappers around the real emulators. Without a list no wrapper exists.
"""
