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
"""
