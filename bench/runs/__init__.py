"""What a run leaves on disk, readable at any instant.

::

    procedure.yaml, station.yaml, *.dbc   as run
    provenance.json                       versions, instrument identities, hashes, options
    journal.jsonl                         what was done, one JSON object a line, on the disk at once
    can/part-00001.blf ...                every CAN frame received
    telemetry/part-00001.parquet ...      readings of the instruments
    guard.log                             what the guard saw and did
    dwells.csv, bias_bins.csv             results
    figures/*.png, report.html

``folder`` has these paths; ``journal``, ``can_log``, ``telemetry`` and ``provenance`` write and read the
files of the same name, ``tables`` the further results. ``marks`` in the journal say which frames make a
dwell; ``seal`` signs the whole. ``index`` finds runs among many.
"""
