"""Choosing and running the next measurement until the effect behind a residual is identified.

``investigation`` is the loop. ``open_hypotheses`` gives the hypotheses that a search leaves open, ``blocks``
the possible measurements; ``forecast`` and ``choice`` predict the outcome of each, and ``proposal`` selects
the one that distinguishes most per hour. An adaptive campaign also measures what the ``profile`` of its
procedure requires. A block is measured as a procedure (``block_procedure``) or by a command
(``external_bench``), and ``stages`` is the record of an investigation.
"""
