"""The one simulated truth behind the emulated instruments.

Chamber air, the unit's case, and for each gyro its optics and electronics as a thermal network;
the two axes of the table; gyros and accelerometers with all their errors; and an INS that aligns
itself and navigates by a full nonlinear strapdown mechanisation. A world file sets it all.

Conventions: navigation frame East-North-Up; ``C_nb`` turns body vectors into it; SI units inside,
units in the key names of the world file.
"""
