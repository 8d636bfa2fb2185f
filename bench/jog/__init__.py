"""The bench by hand: moves, set points and looks, one command at a time, within the station's limits."""
