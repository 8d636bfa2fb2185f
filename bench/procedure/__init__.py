"""Procedures: the YAML file, its checked model, and the plan of timed steps; without any instrument.

``procedure_file`` is the file's model, ``steps`` and ``rotation_steps`` are its kinds of step. ``plan``
unrolls it, with the expected state of the bench from ``estimate``. ``checks`` finds problems of a plan,
``timeline`` gives the rows and curves that are shown. ``approach`` has the steps that restore the state of
the bench after an interruption.
"""
