"""Characteristics of the gyros beyond their biases: the further tests of laser gyros, one result each.

``requested_tests`` is the section of a procedure that asks for them: ``turn_on``, ``warm_up``,
``thermal_sensitivity``, ``allan_test`` and ``scale_factor`` are one test each; ``profile_fit`` has the least
squares of several. All give ``results``.
"""
