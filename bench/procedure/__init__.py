"""Procedures: YAML, its checked model, and the plan that follows from it.

``document`` reads a file, ``steps`` holds the kinds of step, ``plan`` unrolls a procedure into
a flat list of timed steps, ``checks`` looks for what can't work before anything moves, and
``timeline`` shows a plan to people. Nothing here speaks to an instrument.
"""
