"""A new station file with the numbers of a bench."""

import re

NUMBERS = {
    "latitude_deg": 48.1,
    "height_m": 520,
    "rate_dps": 20,
    "acceleration_dps2": 20,
    "jerk_dps3": 80,
    "outer_deg": [-200, 200],
    "inner_deg": [-380, 380],
    "low_c": -40,
    "high_c": 70,
    "ramp_c_per_min": 3,
    "angle_random_walk_deg_per_sqrt_h": 0.002,
    "velocity_random_walk_ug_per_sqrt_hz": 10,
}


def filled_in(text):
    """The text with numbers in place of the placeholders for them; ports and description are left."""
    for key, value in NUMBERS.items():
        text, count = re.subn(rf"^( +{key}: )fill_in", rf"\g<1>{value}", text, flags=re.MULTILINE)
        assert count == 1, key
    return text
