"""Recordings of what instruments exchange with the bench, their replay, and served emulators."""
