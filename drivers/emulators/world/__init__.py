"""The simulated physics behind the emulated instruments: chamber air, table, INS and its sensors.

Conventions: navigation frame East-North-Up; ``C_nb`` turns body vectors into it; SI units inside,
units in the key names of the world file. :class:`~.world.World` steps all of it.
"""
