"""Runs that are killed, hurt and kept going for long, and a table of what became of them.

``python -m tests.soak all --table docs/soak.md`` does all of it; each part can be run alone and keeps its
result, so that the table can be put together from parts: :mod:`.kills`, :mod:`.faults`, :mod:`.fuzz`,
:mod:`.long_run`, :mod:`.real_time`.
"""
