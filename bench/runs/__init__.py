"""Files of a run folder, readable at any time.

::

    procedure.yaml, station.yaml, *.dbc   as run
    provenance.json                       versions, instrument identities, hashes, options
    journal.jsonl                         events, one JSON object a line, each on the disk at once
    can/part-00001.blf ...                every CAN frame received
    telemetry/part-00001.parquet ...      readings of the instruments
    guard.log                             observations and actions of the guard
    dwells.csv, bias_bins.csv             results
    figures/*.png, report.html

``folder`` defines these paths; ``journal``, ``can_log``, ``telemetry`` and ``provenance`` write and read the
files of the same name, ``tables`` the other results. ``marks`` are journal entries that state the frames of a
dwell; ``locks`` excludes a second process; ``seal`` signs the folder; ``index`` finds runs among many.
"""
