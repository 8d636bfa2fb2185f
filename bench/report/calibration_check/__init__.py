"""Calibration check (a calibration tested by new measurements): report section and terminal table."""
