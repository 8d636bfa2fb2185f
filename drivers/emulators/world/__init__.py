"""The simulated physics behind the emulated instruments: chamber air, table, INS and its sensors.

Conventions: the navigation frame is East-North-Up; ``C_nb`` transforms body vectors to it. The code uses SI
units; in the world file the unit is part of each key. :class:`~.world.World` simulates all parts together.
"""
