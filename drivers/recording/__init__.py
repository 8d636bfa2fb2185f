"""Recordings of the exchanges with an instrument: written, read, and replayed to its driver.

A recording of a line is a text file: a header in YAML that describes the recording, a line ``---``, and
one line for each transfer, with its time in seconds since the line was opened, its direction, its bytes, and
its bytes as text::

    recording: 1
    instrument: chamber
    dialect: watlow_f4
    ---
    #   time s    bytes                          text
      0.000000 >  01 03 02 5e 00 01 e5 a0        |...^....|
      0.012000 <  01 03 02 00 01 79 84           |.....y.|

``>`` are bytes sent to the instrument, ``<`` bytes received from it. Everything right of ``|`` and lines
that begin with ``#`` are comments. A recording of a CAN bus is a log of python-can.
"""
