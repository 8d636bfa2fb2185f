"""Figures as matplotlib figures; none touches the global state of matplotlib."""
