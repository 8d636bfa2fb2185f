"""One snapshot of a run, shown in the terminal and on a page in the browser.

``snapshot`` holds everything that a view shows at one time. ``snapshot_recorder`` makes it during a run and
writes it to the run folder; ``run_list`` makes it from the files of a run folder. ``website`` answers
requests of the ``server`` with pages, made from ``page_content``, ``charts`` and ``attitude_drawing``, and
with ``metrics``. ``terminal_view`` shows it in the ``terminal``: ``terminal_screen`` makes the lines,
``terminal_plot`` the plots.
"""
