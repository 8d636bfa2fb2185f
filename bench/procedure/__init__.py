"""Procedures: the YAML file, its checked model, and the plan of timed steps; without any instrument.

``procedure_file`` is the file's model, ``steps`` and ``rotation_steps`` are its kinds of step. ``plan``
unrolls it, with the state of the bench by ``estimate``; ``checks`` finds what can't work, ``timeline`` gives
the rows and curves that are shown. ``approach`` has the steps that restore the state of the bench after an
interruption.
"""
