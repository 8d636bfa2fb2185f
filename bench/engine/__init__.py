"""Runs a plan tick by tick, handles what interrupts it, and leaves the bench in its safe state.

``run`` starts or resumes a run from its ``job``, ``engine`` executes the plan, ``actions`` performs each
kind of step by what the ``step_context`` offers. ``live_bench`` polls the instruments,
``bench_state`` records what they were commanded to do, ``interlocks`` compares the two, and ``holding`` waits
until a run may continue. ``units`` are what the run measures: each is a ``measured_unit`` with its dwell in
progress, and its INS is a ``live_unit``.
"""
