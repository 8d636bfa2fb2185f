"""From CAN frames to measured biases: the same path live and from the raw log.

``marks`` says which frames make a dwell and what the rest of the bench was doing; ``dwell``
turns marks and frames into a row of the dwell table; ``replay`` does that for a whole run from
what it left on disk.
"""
