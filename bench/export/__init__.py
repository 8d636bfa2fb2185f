"""Data out of a run folder, for other tools: tables, readings, navigation, CAN frames, compensation.

``run_export`` decides what is written; one module makes each kind. Everything says its units and where it
came from.
"""
