"""The index of many runs: their folders, tables of their results, selections, and drift over time."""
