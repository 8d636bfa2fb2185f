"""Kinds and sizes of faults in the frames of a dwell: kind, size, and what makes it of a recording.

Each takes a :class:`Recording` and a random generator, and gives the faulty recording.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.bench.dwells.frame_faults import (
    ELECTRONICS,
    EPOCH,
    HEADING,
    OPTICS,
    ROLL_PITCH,
    STATUS,
    TIME,
    VELOCITY,
)

#: Fields of the navigation output: message, byte, kind.
NAVIGATION = {
    "velocity N": (VELOCITY, 0, "i4"),
    "velocity E": (VELOCITY, 4, "i4"),
    "roll": (ROLL_PITCH, 0, "i4"),
    "pitch": (ROLL_PITCH, 4, "i4"),
    "heading": (HEADING, 0, "i4"),
}


def somewhere(recording, rng):
    """A frame in one of the windows."""
    return recording.row_at(0.1 + 0.8 * rng.random(), int(rng.integers(2)))


def from_on(recording, identifier, begin):
    numbers = np.flatnonzero(recording.frames.arbitration_id == identifier)
    return numbers[numbers >= begin]


def lost_share(share):
    return lambda r, rng: r.without(np.flatnonzero(rng.random(len(r.frames)) < share))


def lost_seconds(duration_s):
    return lambda r, rng: r.without(r.seconds(somewhere(r, rng), duration_s))


def repeated(share):
    def make(r, rng):
        numbers = np.arange(len(r.frames))
        return r.arriving(np.repeat(numbers, 1 + (rng.random(len(numbers)) < share)))

    return make


def out_of_order(share, places):
    def make(r, rng):
        numbers = np.arange(len(r.frames), dtype=float)
        numbers[rng.random(len(numbers)) < share] += places + 0.5
        return r.arriving(np.argsort(numbers, kind="stable"))

    return make


def flipped(identifier, bit):
    return lambda r, rng: r.with_flipped_bit(int(rng.choice(r.rows(identifier))), bit // 8, bit % 8)


def flipped_share(share):
    def make(r, rng):
        rows = r.rows(*EPOCH)
        for row in rows[rng.random(len(rows)) < share]:
            r = r.with_flipped_bit(row, int(rng.integers(8)), int(rng.integers(8)))
        return r

    return make


def counter_jump(epochs):
    return lambda r, rng: r.with_more(from_on(r, HEADING, somewhere(r, rng)), 4, "u2", epochs)


def second_node(identifier, byte, kind, change):
    """Sends the same with one field changed, the nth frame by ``change(n)``."""

    def make(r, rng):
        own = np.flatnonzero(r.frames.arbitration_id == identifier)
        changed = r.with_more(own, byte, kind, change(np.arange(len(own))))
        return r.with_second_node(identifier, changed.frames.data[own])

    return make


def stamps_jump(seconds):
    def make(r, rng):
        stamps_s = r.frames.timestamp_s.copy()
        stamps_s[somewhere(r, rng) :] += seconds
        return replace(r, frames=r.frames.with_fields(time_s=stamps_s))

    return make


def stuck(names, duration_s):
    """Fields keep their values for a time; None for a whole window."""

    def make(r, rng):
        window = int(rng.integers(2))
        heading = r.rows(HEADING, window=window)
        stamps_s = r.frames.timestamp_s[heading]
        begin_s, end_s = stamps_s[0], stamps_s[-1]
        if duration_s is not None:
            begin_s += max(0.0, end_s - begin_s - duration_s) * rng.random()
            end_s = begin_s + duration_s
        for name in names:
            message, byte, kind = NAVIGATION[name]
            rows = r.rows(message, window=window)
            at_s = r.frames.timestamp_s[rows]
            r = r.stuck(rows[(at_s >= begin_s) & (at_s <= end_s)], byte, kind)
        return r

    return make


def set_to(identifier, byte, kind, value, share):
    """A field has a value in some neighbouring frames, one at least."""

    def make(r, rng):
        rows = r.rows(identifier)
        count = max(1, int(share * len(rows)))
        begin = int(rng.integers(0, len(rows) - count + 1))
        return r.with_field(rows[begin : begin + count], byte, kind, value)

    return make


def temperature_step(kelvin):
    return lambda r, rng: r.with_more(from_on(r, OPTICS, somewhere(r, rng)), 4, "i2", round(100.0 * kelvin))


def temperature_noise(kelvin):
    def make(r, rng):
        rows = r.rows(OPTICS)
        return r.with_more(rows, 4, "i2", np.rint(rng.normal(0.0, 100.0 * kelvin, len(rows))).astype(int))

    return make


def output_step(velocity_lsb, heading_lsb):
    """As of an INS that restarted without a status."""

    def make(r, rng):
        begin = somewhere(r, rng)
        r = r.with_more(from_on(r, VELOCITY, begin), 4, "i4", velocity_lsb)
        return r.with_more(from_on(r, HEADING, begin), 0, "i4", heading_lsb)

    return make


def turned(arcsec, duration_s, *, both_windows=False, back=False):
    """The table turned by hand, evenly over a time or a whole window, and brought back or not."""

    def make(r, rng):
        for window in (0, 1) if both_windows else (int(rng.integers(2)),):
            rows = r.rows(HEADING, window=window)
            stamps_s = r.frames.timestamp_s[rows]
            whole_s = stamps_s[-1] - stamps_s[0]
            takes_s = min(duration_s or whole_s, whole_s)
            begin_s = stamps_s[0] + (whole_s - takes_s) * rng.random()
            share = np.clip((stamps_s - begin_s) / takes_s, 0.0, 1.0)
            r = r.turned_by_hand(rows, (np.sin(np.pi * share) ** 2 if back else share) * arcsec / 3600.0)
            later = from_on(r, HEADING, rows[-1] + 1)
            r = r.turned_by_hand(later, np.full(len(later), 0.0 if back else arcsec / 3600.0))
        return r

    return make


_MESSAGES = {
    "velocity": VELOCITY,
    "roll and pitch": ROLL_PITCH,
    "heading": HEADING,
    "temperature": OPTICS,
    "time": TIME,
    "status": STATUS,
}
_BITS = (0, 4, 8, 12, 16, 20, 24, 28, 31, 32, 40, 47, 48, 50, 56, 60, 63)
_SHARES = {"one": 0.0, "5 %": 0.05, "all": 1.0}
_VALUES = {
    "velocity saturated": (VELOCITY, 4, "i4", 2**31 - 1),
    "heading saturated": (HEADING, 0, "i4", 2**31 - 1),
    "heading marked invalid": (HEADING, 0, "i4", -(2**31)),
    "attitude not valid": (HEADING, 7, "u1", 0),
    "alignment lost": (HEADING, 6, "u1", 0),
    "mode aligning": (STATUS, 0, "u1", 2),
    "temperature saturated": (OPTICS, 0, "i2", 32767),
    "temperature marked invalid": (OPTICS, 2, "i2", -32768),
    "temperature of 200 degC": (OPTICS, 2, "i2", 20000),
    "electronics saturated": (ELECTRONICS, 0, "i2", 32767),
}

FAULTS = [
    ("none", "", lambda r, rng: r),
    ("frames lost", "one", lambda r, rng: r.without([rng.choice(r.rows(*EPOCH))])),
    *(("frames lost", f"{share:.0%}", lost_share(share)) for share in (0.01, 0.1)),
    *(("frames lost", f"{duration} s", lost_seconds(duration)) for duration in (1, 10, 600)),
    *(("frames repeated", f"{share:.0%}", repeated(share)) for share in (0.0001, 0.01, 1.0)),
    *(("frames out of order", f"1 % by {places}", out_of_order(0.01, places)) for places in (1, 3, 20)),
    *(
        (f"bit flipped, {name}", f"bit {bit}", flipped(identifier, bit))
        for name, identifier in _MESSAGES.items()
        for bit in _BITS
    ),
    ("bits flipped", "0.1 % of frames", flipped_share(0.001)),
    *(("counter jumps", f"{epochs}", counter_jump(epochs)) for epochs in (1, 10, 100, 1000, 30000)),
    *(
        (
            "second node, velocity",
            f"+{lsb} LSB",
            second_node(VELOCITY, 4, "i4", lambda n, lsb=lsb: lsb + 0 * n),
        )
        for lsb in (10, 1000, 100000)
    ),
    ("second node, velocity", "quadratic", second_node(VELOCITY, 4, "i4", lambda n: n**2 // 1000)),
    ("second node, roll", "ramp", second_node(ROLL_PITCH, 0, "i4", lambda n: n)),
    ("second node, heading", "ramp", second_node(HEADING, 0, "i4", lambda n: n)),
    ("second node, heading", "other counter", second_node(HEADING, 4, "u2", lambda n: 7 + 0 * n)),
    ("second node, temperature", "1 K", second_node(OPTICS, 0, "i2", lambda n: 100 + 0 * n)),
    ("second node, temperature", "10 K", second_node(OPTICS, 0, "i2", lambda n: 1000 + 0 * n)),
    ("second node, status", "aligning", second_node(STATUS, 0, "u1", lambda n: -1 + 0 * n)),
    ("second node, time", "+1000 s", second_node(TIME, 0, "u4", lambda n: 1000 + 0 * n)),
    *(("time stamps jump", f"{s:g} s", stamps_jump(s)) for s in (-3600.0, -30.0, 10.0, 3600.0, 6553.6, 1e5)),
    ("foreign frames", "3 for each", lambda r, rng: r.with_foreign_frames(3)),
    *(
        (f"{name} stuck", "window" if duration is None else f"{duration} s", stuck([name], duration))
        for name in NAVIGATION
        for duration in (1, 3, 10, 30, None)
    ),
    *(
        ("output stuck", "window" if duration is None else f"{duration} s", stuck(list(NAVIGATION), duration))
        for duration in (1, 3, 10, 30, None)
    ),
    *(
        (name, size, set_to(*field, share))
        for name, field in _VALUES.items()
        for size, share in _SHARES.items()
    ),
    *(("temperature jumps", f"{step} K", temperature_step(step)) for step in (0.5, 2.0, 10.0, -40.0)),
    *(("temperature noisy", f"{sigma} K", temperature_noise(sigma)) for sigma in (0.3, 3.0, 30.0)),
    *(("output steps, velocity", f"{lsb} LSB", output_step(lsb, 0)) for lsb in (5, 20, 100, 1000)),
    *(("output steps, heading", f"{lsb} LSB", output_step(0, lsb)) for lsb in (5, 20, 100, 1000, 10000)),
    *(
        ("turned by hand", f"{arcsec} arcsec in {duration or 'window'} s", turned(arcsec, duration))
        for duration in (1, 10, 30, None)
        for arcsec in (0.03, 0.1, 0.3, 1.0, 3.6, 10.0, 100.0)
    ),
    *(
        (
            "turned and back",
            f"{arcsec} arcsec in {duration or 'window'} s",
            turned(arcsec, duration, back=True),
        )
        for duration in (1, 10, None)
        for arcsec in (0.3, 1.0, 3.6, 10.0, 100.0)
    ),
]
