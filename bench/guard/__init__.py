"""The guard: a separate process that makes the bench safe when the engine can't.

The engine's side is ``process``; it sends a beat through a pipe at every tick. ``watching`` listens, and
``rescue`` acts when the pipe closes without a release (the engine died) or no beat comes for too long (it
hangs, and is killed first). On start-up the process imports only the clock and small modules of this
folder, so that it watches within a moment; it then loads what a rescue needs at once, so that no file
has to be read later.

It has its own session and ignores the signals that end the engine. A service manager that kills every
process of a service ends the guard with the engine: under systemd the unit needs ``KillMode=process``.
"""
