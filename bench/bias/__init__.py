"""Gyro bias from dwells: estimators with their uncertainty, noise, plateaus, bins and acceptance.

A dwell is one position at one temperature: navigation at azimuth 0, a turn of 180 deg about the
vertical, navigation again. A bias is the error of a gyro's rate, positive where the gyro reads too
much about its body axis.
"""
