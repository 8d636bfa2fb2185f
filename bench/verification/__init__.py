"""Proof, by new measurements, of a compensation that was loaded into the INS.

``compensation_verification`` compares the runs with each compensation: ``paired_plateaus`` pairs their
plateaus, ``run_residuals`` gives what is left in each, and ``measured_change`` holds the change against the
numbers loaded. ``coefficient_verification`` does the same for all coefficients.
"""
