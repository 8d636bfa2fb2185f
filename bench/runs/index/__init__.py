"""The index of many runs: where they lie, tables of what they hold, selections and drift over time."""
