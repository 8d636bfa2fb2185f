"""Manual control of the bench: moves, set points and readings, one command at a time, within the limits."""
