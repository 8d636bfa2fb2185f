"""From CAN frames to measured biases and coefficients: the same path live and from the raw log.

The journal has the marks of each dwell: its frames and the state of the bench. ``measure_dwell`` turns marks
and frames into a row of the dwell table, after ``temperatures``, ``output_checks``, ``sign_check`` and
``setup_check`` with its ``velocity_regression``; ``rotated_dwell``, ``rotations`` and
``plateau_calibration`` turn those of rotations into coefficients, and ``check_dwell`` and
``calibration_check`` compare with an ``earlier_calibration``.
``run_dwells`` collects the dwells of a run, ``recorded_dwells`` reads them back from its folder,
``run_results`` evaluates them together. ``live_estimate`` shows a bias while its dwell is measured.
"""
