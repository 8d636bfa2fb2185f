"""Results for people, from run folders alone: figures, pages of findings, tables for the terminal.

The modules import matplotlib, Jinja2, rich or pyarrow: import them where they are used, not at the start of
a program.
"""
