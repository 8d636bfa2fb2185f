"""Noise of an INS: what it does to estimates, and how its output tells it."""
