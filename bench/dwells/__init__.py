"""From CAN frames to measured biases: the same path live and from the raw log.

``marks`` names the frames of a dwell and the state of the bench; ``dwell`` turns marks and frames into a row
of the dwell table; ``run_dwells`` does that for a whole run and evaluates its dwells together.
"""
