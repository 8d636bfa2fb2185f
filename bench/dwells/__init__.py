"""From CAN frames to measured biases and coefficients: the same path live and from the raw log.

The journal has the marks of each dwell: its frames and the state of the bench. ``measurement_setup`` turns
both into biases. ``dwell_output`` decodes the frames and cuts them into windows at rest; ``temperatures``,
``output_checks``, ``sign_check`` and ``setup_check`` with its ``velocity_regression`` find what is wrong;
``measure_dwell`` makes a row of the dwell table. ``run_dwells`` collects the dwells of a run, or reads them
back from its folder, and ``run_results`` evaluates them together, after ``latitude``, and fills the tables.
``live_estimate`` shows a bias while its dwell is measured.

``rotated_dwell``, ``run_rotations`` and ``plateau_calibration`` turn dwells with rotations into coefficients,
and ``calibration_check`` compares with an ``earlier_calibration``.
"""
