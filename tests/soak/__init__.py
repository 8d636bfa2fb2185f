"""Runs that are killed, disturbed and kept running for long, and a table of the outcomes.

``python -m tests.soak all --table docs/reliability.md`` does all of it; each part can be run alone and
keeps its result, so that the table can be put together from parts: :mod:`.kills`, :mod:`.faults`,
:mod:`.fuzz`, :mod:`.long_run`, :mod:`.real_time`.
"""
