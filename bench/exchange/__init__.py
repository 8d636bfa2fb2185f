"""Import of logs of a real IMU or INS into a dwell table, and export of a run's data for other tools."""
