"""Recordings of what was exchanged with an instrument: kept, read again, and replayed to its driver.

A recording of a line is a text file: a header in YAML that says what was recorded, a line ``---``,
and one line a transfer, with its time in seconds since the line was opened, its direction, its bytes
and the same as text::

    recording: 1
    instrument: chamber
    dialect: watlow_f4
    ---
    #   time s    bytes                          text
      0.000000 >  01 03 02 5e 00 01 e5 a0        |...^....|
      0.012000 <  01 03 02 00 01 79 84           |.....y.|

``>`` is what was sent to the instrument, ``<`` what came from it. The text is for people; what is not
right of ``|`` counts. Lines that begin with ``#`` are remarks. A recording of a CAN bus is a log of
python-can.
"""
