"""Reports from run folders: run report, pages of findings, figures, tables for the terminal.

``run_content`` reads a run folder. ``run_report`` composes its report from the sections of the modules
``*_section`` and ``*_sections``. ``run_text`` has the sentences about results, ``run_findings`` those about
doubtful results. ``units_report`` is the report of several units. ``closure_page``, ``verification_page`` and
``investigation_page`` write pages, the first two with the sentences of ``*_text``. ``page`` renders sections
as HTML and PDF, ``figures`` draws, ``terminal`` prints, and ``number_format`` formats numbers.

The modules import matplotlib, Jinja2, rich or pyarrow: import them where they are used, not at the start of
a program.
"""
