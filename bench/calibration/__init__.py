"""Calibration of all sensor coefficients from increments of angle and velocity over a list of rotations.

``increment_recording`` finds rests and rotations in the increments, ``section`` splits them into epochs,
``strapdown`` integrates them, ``whitening`` makes white rows of a least-squares problem of the result,
``information`` solves the rows, ``problem`` iterates until the solution converges, and ``estimator`` makes a
calibration of recordings: the ``coefficients`` with all that qualifies them. ``spins`` gives the gyros' scale
factors from whole turns, ``joint_coefficients`` the coefficients from dwells without rotations.
``rotation_list`` predicts the uncertainties of a list of rotations, and ``list_search`` finds the shortest
list for given uncertainties. ``mission`` computes the position error that remains.
"""
