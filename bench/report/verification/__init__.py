"""The verification of a calibration, in the report and in the terminal."""
