"""Calibration certificates: their content from a run folder, as PDF and as DCC, signed and verified."""
