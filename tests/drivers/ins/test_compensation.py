"""The compensation of an INS: its numbers, terms and checksum."""

import struct
import zlib

import numpy as np
import pytest

from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.drivers.ins.compensation import TERMS, Compensation, checksum
from tests.drivers.ins.compensation_reference import TERM_NUMBERS

BASE = {
    "polynomial_dph": np.array([[0.01, 1e-4, -2e-6], [0.02, 0.0, 0.0], [-0.01, 2e-4, 1e-6]]),
    "low_c": np.full(3, -20.0),
    "high_c": np.full(3, 70.0),
}


def compensation(*terms, **changes):
    numbers = {name: value for term in terms for name, value in TERM_NUMBERS[term].items()}
    return Compensation(**{**BASE, **numbers, **changes})


def test_the_terms_in_use_are_named():
    assert compensation().terms() == ()
    assert compensation(*TERMS).terms() == tuple(TERMS)
    assert compensation("warm_up").terms() == ("warm_up",)


def test_the_checksum_is_the_crc_of_32_bit_floats():
    numbers = [0.1, -2.5, 1e-7]
    assert checksum(numbers) == zlib.crc32(struct.pack("<3f", *numbers))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"low_c": np.full(3, 80.0)}, "low_c must not be above high_c"),
        ({"low_c": np.zeros(2)}, r"low_c has the shape \(2,\), not \(3,\)"),
        ({"polynomial_dph": np.full((3, 2), np.nan)}, "polynomial_dph must hold finite numbers"),
        ({"polynomial_dph": np.zeros((2, 4))}, "polynomial_dph has the shape"),
        ({"polynomial_dph": np.zeros((3, 0))}, "polynomial_dph has the shape"),
        ({"rate_dph_per_c_per_h": np.array([0.0, 1.0, 0.0])}, "needs rate_limit_c_per_h above zero"),
        ({"warm_up_dph": np.ones(3), "warm_up_s": np.array([1.0, 0.0, 1.0])}, "needs warm_up_s above zero"),
        ({"growing_dph_per_k": np.ones((3, 3))}, "needs onset_width_c above zero"),
        ({"gradient_dph_per_k": np.ones(3)}, "needs difference_low_k below difference_high_k"),
    ],
)
def test_numbers_that_mean_nothing_are_mistakes(changes, message):
    with pytest.raises(MeasurementError, match=message):
        compensation(**changes)
