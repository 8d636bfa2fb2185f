"""Calibration of all sensor coefficients from increments of angle and velocity over a list of rotations."""
