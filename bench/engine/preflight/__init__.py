"""Preflight check: is the bench ready for a run? Moves nothing."""
