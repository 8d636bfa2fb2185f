"""Interlocks: the station's limits, checked at every tick independently of the procedure.

``checks`` finds violations on table, chamber and INS; ``watch`` converts them to trips. The checks look at
levels, not at changes: a violation that exists when a run begins trips at once, until it has cleared.
"""
