"""Frames, the six positions, the axes of the table, Earth rate and gravity.

A direction of the navigation frame is an array (East, North, Up); ``C_nb`` (..., 3, 3) has the
body's x, y and z axes, resolved in that frame, as its columns.
"""
