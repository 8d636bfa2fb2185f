"""Characteristics of the gyros other than their biases: further tests of laser gyros.

``requested_tests`` is the section of a procedure that requests them. ``turn_on``, ``warm_up``,
``thermal_sensitivity``, ``allan_test`` and ``scale_factor`` are one test each; several use the least squares
in ``profile_fit``. Each returns its ``results``.
"""
