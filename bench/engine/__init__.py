"""Running a plan: tick by tick on one clock, and to the safe state at any end.

``live_bench`` holds the opened instruments and what they last said, ``actions`` performs each
kind of step, ``engine`` walks the plan, ``safe_state`` ends it.
"""
