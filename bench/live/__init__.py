"""A run while it goes on: the picture of it, who records it, and how it is seen in the terminal.

``picture`` is all that a view needs at one moment; ``recorder`` makes it while a run goes on and leaves it
in the run folder, ``from_folder`` makes it from what a run left. ``lines_view`` and ``terminal_view`` show
a run in the terminal; ``terminal_operator`` asks the person who sits there.
"""
