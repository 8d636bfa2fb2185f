"""Procedures: the YAML file, its checked model, and the plan of timed steps; without any instrument."""
