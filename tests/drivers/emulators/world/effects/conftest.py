import numpy as np
import pytest

from gyrobench.drivers.emulators.world.effects.effect import Conditions

TRIPLES = ("optics_c", "electronics_c", "optics_rate_c_per_h", "convected_w", "up_body")


def conditions_with(**changes):
    """Conditions of a unit at 25 degC, level, long after power-on, with some of them changed.

    One number for a value of three gyros stands for all of them.
    """
    usual = {
        "time_s": 1e5,
        "since_power_on_s": 1e5,
        "optics_c": 25.0,
        "electronics_c": 37.0,
        "optics_rate_c_per_h": 0.0,
        "convected_w": 0.0,
        "up_body": (0.0, 0.0, 1.0),
        "compressor_duty": 0.0,
    }
    values = usual | changes
    for name in TRIPLES:
        values[name] = np.broadcast_to(np.asarray(values[name], dtype=float), 3)
    return Conditions(**values)


@pytest.fixture(scope="session")
def conditions():
    return conditions_with
