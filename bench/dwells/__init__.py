"""From CAN frames to measured biases and coefficients: the same path live and from the raw log.

The journal holds the marks of each dwell: which frames belong to it, and the state of the bench.
``measurement_setup`` has the settings that the analysis of all dwells of a run uses. ``dwell_output`` decodes
the frames and cuts them into windows at rest; ``temperatures``, ``output_checks``, ``sign_check`` and
``setup_check`` with its ``velocity_regression`` detect faults; ``measure_dwell`` makes a row of the dwell
table. ``run_dwells`` collects the dwells of a run, or measures them again from its folder; ``run_results``
evaluates them together, corrects a wrong ``latitude`` and writes the tables. ``live_estimate`` estimates the
bias of a dwell while it is measured.

``rotated_dwell``, ``run_rotations`` and ``plateau_calibration`` turn dwells with rotations into coefficients.
``calibration_check`` compares new dwells with an ``earlier_calibration``.
"""
