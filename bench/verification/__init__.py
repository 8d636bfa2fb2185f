"""Verifies a compensation loaded into the INS by new measurements.

``compensation_verification`` compares the runs with each compensation: ``paired_plateaus`` pairs their
plateaus, ``run_residuals`` evaluates the residual biases of each run, and ``measured_change`` compares the
change with the coefficients loaded. ``coefficient_verification`` does the same for all coefficients.
"""
