"""The search for effects: its page, its part of a run's report, its summary in the terminal."""
