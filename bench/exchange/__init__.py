"""Import of logs of a real IMU or INS into a dwell table, and export of a run's data for other tools.

``log_import`` reads a log by its ``import_map``: ``log_files`` and ``signal_logs`` read its columns,
``log_windows`` computes means over windows, and ``window_checks`` decides which windows are valid.
``increments`` reads a log for a calibration. ``run_export`` writes a run into an ``export_folder``, with the
CAN log by ``can_export`` and ``mf4``.
"""
