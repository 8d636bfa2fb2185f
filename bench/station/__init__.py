"""The station: the instruments of a bench, their connections, and its limits.

``station_file`` is the station file's model, with ``instrument_sections``, ``interlocks`` and the
``receivers`` of messages as its parts. ``station`` derives kinematics and limits from it, ``instruments``
opens the instruments, ``safe_state`` brings them to their safe state, and ``bench_lock`` excludes a second
run.
"""
