"""The guard: a separate process that makes the bench safe when the engine can't.

The engine's side is ``process``; it sends a heartbeat through a pipe at every tick. ``watching`` receives it,
and ``rescue`` acts if the pipe closes without a release (the engine died) or no heartbeat comes for too long
(the engine hangs, and is killed first). At start-up the process imports only the clock and ``watching``, so
that it watches quickly; it then immediately loads all modules that a rescue needs, so that no file has to be
read later.

It has its own session and ignores the signals that end the engine. A service manager that kills every
process of a service ends the guard with the engine: under systemd the unit needs ``KillMode=process``.
"""
