"""Running a plan: tick by tick on one clock, through what happens, and to the safe state at any end.

``session`` makes a run or goes on with one, ``engine`` walks the plan, ``actions`` performs each kind
of step. ``live_bench`` holds the instruments and what they last said, ``interlocks`` watches it,
``heartbeat`` lets ticks pass; ``holding`` waits until a run may go on, ``outputs`` makes the bench
safe. ``preflight`` looks at a bench before a run.
"""
