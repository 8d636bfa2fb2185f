"""Logs of a real IMU or INS, turned into the dwell table that the bench itself would write.

A YAML mapping says what stands where in the log (:mod:`.document`). The log is read in batches
(:mod:`.text_log`, :mod:`.record_log`), its columns become quantities in one set of units
(:mod:`.samples`), windows of these are averaged (:mod:`.windows`) and checked (:mod:`.checks`), and
each good window becomes one row (:mod:`.dwell_rows`). :mod:`.log_import` is the way in.

The unit is at rest in each window. Rates are deg/h, temperatures degC, times seconds since the first
sample of the log, axes those of the unit's body.
"""
