"""Frames, the six positions, the axes of the table, Earth rate, gravity and the error model of an INS.

A vector of the navigation frame is an array (East, North, Up). The columns of ``C_nb`` (..., 3, 3) are the
body's x, y and z axes, resolved in that frame.
"""
