"""Calibration of all sensor coefficients from increments of angle and velocity over a list of rotations.

``increment_recording`` finds rests and rotations in the increments, ``section`` cuts them into epochs between
rests, ``strapdown`` turns these into white rows of a least-squares problem, ``information`` gathers the rows,
``problem`` solves it, and ``estimator`` finds the ``coefficients`` with it; ``spins`` adds the gyros' scale
factors from whole turns, ``joint_coefficients`` are those that dwells without rotations show.
``rotation_list`` predicts what a list of rotations determines, and ``list_search`` finds the shortest one.
``mission`` is the position error that remains.
"""
