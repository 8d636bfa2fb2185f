"""Characteristics of the gyros beyond their biases: the further tests of laser gyros, one result each."""
