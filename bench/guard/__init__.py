"""The guard: a process of its own that makes the bench safe when the engine can't.

The engine's side is ``link``; it sends a beat at every tick through a pipe. ``watch`` listens, and
``rescue`` acts when the pipe was closed without a word (the engine died) or nothing came for too
long (it hangs, and is killed first). A process that was only started imports nothing but
the clock and small modules of this folder, and so is there in a moment; what a rescue needs is
loaded at once after that, so that later no file has to be read for it.

It has a session of its own and ignores the signals that end the engine. A service manager that
kills every process of a service ends the guard with the engine: under systemd the unit needs
``KillMode=process``.
"""
