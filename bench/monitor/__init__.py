"""One snapshot of a run, shown in the terminal and on a page in the browser.

``snapshot`` is all that a view needs at one moment. ``snapshot_recorder`` makes it during a run and leaves it
in the run folder; ``run_list`` makes it from what a run left. ``website`` shows it on pages, from
``page_content``, ``charts`` and ``attitude_drawing``, by its ``server``, and as ``metrics``.
``terminal_view`` shows it in the ``terminal``: ``terminal_screen`` writes its lines, ``terminal_plot`` its
plots.
"""
