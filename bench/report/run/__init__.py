"""The parts of a run's report, each made from what the run's folder holds."""
