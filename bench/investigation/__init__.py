"""Choosing and running the next measurement until the effect behind a residual is identified."""
