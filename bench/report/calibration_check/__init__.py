"""The calibration check (a calibration tested by new measurements): its section of the report, its terminal table."""
