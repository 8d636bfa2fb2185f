"""Gyro bias of one dwell by least squares on the full error model of an INS at rest.

``causes`` lists the unknowns; ``whitening`` and ``window_filter`` make the output of one window
white; ``bias_filter`` joins the windows of a dwell and estimates; ``fit_test`` tells whether the
model explains the data.
"""
