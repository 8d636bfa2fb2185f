"""What people see of a run: figures, the report, tables for the terminal.

All of it is made from what the run left in its folder. The modules import matplotlib, Jinja2, rich
or pyarrow, so import them where they are needed, not at the start of a program.

Figures of several runs are drawn where those are compared: in :mod:`bench.run_index`, the trend of a unit,
and in :mod:`gyrobench.bench.fleet`, a batch of units.
"""
