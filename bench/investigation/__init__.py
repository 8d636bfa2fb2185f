"""Choosing and running the next measurement until the effect behind a residual is identified.

``investigation`` is the loop. ``open_hypotheses`` are those that a search leaves open, ``blocks`` the
measurements that are possible; ``forecast`` and ``choice`` predict what each would show, and ``proposal``
takes the one that distinguishes most per hour. An adaptive campaign also measures what the ``profile`` of its
procedure requires. A block is measured as a procedure (``block_procedure``) or by a command
(``external_bench``), and ``stages`` is the record of it all.
"""
