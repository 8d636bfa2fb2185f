"""Undeclared effects on the gyro biases: what the bench's declared bias model knows nothing of.

Each kind is a model of its entry in the world file, and its physics: the bias that it adds under the
conditions of a moment. ``undeclared_bias`` adds them up. Biases are in deg/h here, body axes.
"""
