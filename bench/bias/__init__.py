"""Gyro bias from dwells: estimators with their uncertainty, noise, plateaus, bins and acceptance.

A dwell is one position at one temperature: navigation at azimuth 0, a turn of 180 deg about the vertical,
navigation again. A bias is the error of a gyro's rate, positive if the gyro reads too high about its body
axis.

``bias_filter`` estimates the biases of a ``dwell``: ``parameters`` has the error model, ``window_filter``
whitens each window by the ``noise_model``, ``bias_steps`` tests for a change within the dwell and ``damping``
for an INS that damps its velocity. ``error_split`` and ``budget`` split the uncertainty by source.
``paper`` is the paper's estimator, ``joint_solution`` solves the dwells of a plateau together, and
``noise_estimate`` estimates the noise from ``allan`` variances. ``dwell_table`` and ``bins`` are the tables
of results, which ``acceptance`` judges.
"""
