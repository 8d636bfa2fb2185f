"""Checks by new measurements: of a calibration, and of a compensation loaded into the INS."""
