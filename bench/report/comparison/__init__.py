"""The proof of a compensation: its page, its part of a run's report, its summary in the terminal."""
