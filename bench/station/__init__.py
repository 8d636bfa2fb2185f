"""The station: which instruments a bench has, how they are reached, and what it may do.

``station_file`` is the station file's model, with ``instrument_sections``, ``interlocks`` and the
``receivers`` of messages as its parts. ``station`` is what follows from it, ``instruments`` opens what it
names, ``safe_state`` brings them to their safe state, and ``locks`` excludes a second run.
"""
