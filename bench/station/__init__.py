"""The station: which instruments a bench has, how they are reached, and what it may do.

``document`` is the station file's model, ``station`` what follows from it, ``instruments`` opens
what it names, ``safe_state`` brings that to its safe state, and ``bench_lock`` keeps a second run
away from it.
"""
