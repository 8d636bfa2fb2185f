"""Recordings of the bytes exchanged with instruments, their replay, and served emulators."""
