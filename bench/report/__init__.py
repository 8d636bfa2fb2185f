"""Results for people, from run folders alone: figures, pages of findings, tables for the terminal.

``run_content`` reads a run folder. ``run_report`` lists the sections of its report, which the modules
``*_section`` and ``*_sections`` make, with the sentences of ``run_text``; ``run_findings`` states what makes
the results doubtful, and ``units_report`` is the report of several units. ``closure_page``,
``verification_page`` and ``investigation_page`` are pages, each with its ``*_text``. ``page`` turns sections
into HTML and PDF, ``figures`` draws them, ``terminal`` prints them, and ``number_format`` writes their
numbers.

The modules import matplotlib, Jinja2, rich or pyarrow: import them where they are used, not at the start of
a program.
"""
