"""Preflight: whether a bench is fit for a run, looked at without moving anything.

``preflight`` asks the checks of ``table``, ``chamber``, ``ins`` and ``disk`` in turn.
"""
