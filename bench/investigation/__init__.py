"""Choosing and running the next measurement until the cause of a residual is settled."""
