"""Interlocks: the station's limits, checked at every tick independently of the procedure.

``checks`` finds what is wrong with table, chamber and INS; ``watch`` turns that into trips. The checks
look at levels, not at changes: what is wrong when a run begins trips at once, until it is good again.
"""
