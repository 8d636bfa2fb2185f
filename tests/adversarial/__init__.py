"""Benches with an ordinary mistake, units with an undeclared error: is any wrong result left unflagged?

``python -m tests.adversarial`` prints the table, ``--table docs/reliability.md`` writes it into the page.
The data come from :mod:`tests.adversarial.strapdown`, which shares no code with bench and emulators, as CAN
frames through the signal map of a station file.
"""
