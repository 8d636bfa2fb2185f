"""The station: which instruments a bench has, how they are reached, and what it may do.

``station_file`` is the station file's model, ``station`` what follows from it, ``instruments`` opens
what it names, ``safe_state`` brings them to their safe state, and ``locks`` excludes a second run.
"""
