"""Verification of a calibration: biases that show without a turn, and the calibrated ones beside them."""
