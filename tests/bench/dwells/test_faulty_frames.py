"""Whatever happens to the frames of a dwell: its numbers are right, or it says that they are not."""

from functools import cache

import numpy as np
import pytest

from gyrobench.bench.dwells.measure_dwell import measure_dwell
from tests.bench.dwells.fault_kinds import FAULTS
from tests.bench.dwells.frame_faults import Recording

#: Faults that cost nothing: the dwell stays good.
HARMLESS = {
    ("none", ""),
    ("frames lost", "one"),
    ("frames lost", "1%"),
    ("frames lost", "1 s"),
    ("frames repeated", "1%"),
    ("frames out of order", "1 % by 1"),
    ("time stamps jump", "-3600 s"),
    ("time stamps jump", "-30 s"),
    ("time stamps jump", "10 s"),
    ("foreign frames", "3 for each"),
    ("electronics saturated", "all"),
}
#: What is said of others.
SAID = {
    ("frames lost", "10 s"): "nothing from the INS for",
    ("counter jumps", "100"): "clock of the INS was reset",
    ("bit flipped, velocity", "bit 24"): "jumps at",
    ("bit flipped, temperature", "bit 31"): "no temperature of the y gyro, so its bias belongs to no bin",
    ("output stuck", "30 s"): "the output is stuck",
    ("heading stuck", "window"): "the heading stays the same",
    ("velocity E stuck", "window"): "the velocity East stays the same",
    ("alignment lost", "5 %"): "reported another alignment",
    ("mode aligning", "one"): "left navigation",
    ("attitude not valid", "one"): "reported an invalid attitude",
    ("velocity saturated", "all"): "velocity is not a number",
    ("temperature saturated", "all"): "x gyro, so its bias belongs to no bin: its sensor gives no reading",
    ("temperature of 200 degC", "all"): "reads 200.0 degC",
    ("temperature jumps", "10.0 K"): "jumps by 10.0 K",
    ("second node, temperature", "10 K"): "does a second node send them",
    ("second node, heading", "ramp"): "contradict those of the same epoch",
    ("output steps, heading", "10000 LSB"): "the heading jumps",
    ("turned by hand", "10.0 arcsec in 10 s"): "bends within 10 s",
}


@pytest.fixture(scope="module")
def measured(recorded):
    """``measured(kind, size)``: row of the ten-minute check's dwell with one fault."""
    marks, frames, setup = recorded
    makers = {(kind, size): (number, make) for number, (kind, size, make) in enumerate(FAULTS)}

    @cache
    def of(*fault):
        number, make = makers[fault]
        faulty = make(Recording(marks, frames), np.random.default_rng(number))
        return measure_dwell(faulty.marks, faulty.frames, setup).row

    return of


def is_slow_turn(fault):
    """A steady turn through a whole window looks like a bias; only the table's own reading shows more."""
    kind, size = fault
    return kind == "turned by hand" and size.endswith("window s")


@pytest.mark.parametrize("every", [8, pytest.param(1, marks=pytest.mark.long)])
def test_no_wrong_number_passes_for_good(measured, every):
    clean = measured("none", "")
    for fault in [(kind, size) for kind, size, _ in FAULTS[::every]] + [*HARMLESS, *SAID]:
        row = measured(*fault)
        if not row.flags and not is_slow_turn(fault):
            off = np.abs(np.subtract(row.bias_dph, clean.bias_dph)) / clean.sigma_dph
            assert off.max() < 4.0, fault
            assert np.abs(np.subtract(row.gyro_c, clean.gyro_c)).max() < 1.0, fault


def test_a_slow_turn_through_one_window_is_noticed_by_the_other(measured):
    for arcsec in (10.0, 100.0):
        assert "the biases of the windows differ" in str(
            measured("turned by hand", f"{arcsec} arcsec in window s").flags
        )


@pytest.mark.parametrize("fault", sorted(HARMLESS), ids=", ".join)
def test_what_costs_nothing_flags_nothing(measured, fault):
    assert measured(*fault).flags == ()


@pytest.mark.parametrize("fault", sorted(SAID), ids=", ".join)
def test_a_flag_says_what_was_wrong(measured, fault):
    assert SAID[fault] in str(measured(*fault).flags)
