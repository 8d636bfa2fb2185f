"""Results as files: the tables of a run, written and read again."""
