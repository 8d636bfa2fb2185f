import json
import re
from dataclasses import fields, replace
from typing import get_args

import numpy as np
import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.runs.compensation_file import (
    CompensationFile,
    _NumberName,
    compensations_in_use,
    read_compensation,
    read_compensation_file,
    write_compensation,
)
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.drivers.ins.compensation import PARAMETER_NAMES, Compensation, Correction

POLYNOMIAL = "polynomial_dph: [[1.0], [2.0], [3.0]]\nlow_c: [-20, -20, -20]\nhigh_c: [70, 70, 70]\n"


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "compensation.yaml"
        path.write_text(text)
        return path

    return write


def test_every_number_of_a_compensation_has_its_key():
    assert list(CompensationFile.model_fields) == ["unit", *(each.name for each in fields(Compensation))]


@pytest.mark.parametrize(("line", "unit"), [("", ""), ("unit: 1001\n", "1001"), ("unit: 'A-7'\n", "A-7")])
def test_a_compensation_is_for_the_unit_that_it_names(written, tmp_path, line, unit):
    path = written(line + POLYNOMIAL)
    assert read_compensation_file(path).serial_number == unit
    write_compensation(tmp_path / "again.yaml", read_compensation(path), unit)
    assert read_compensation_file(tmp_path / "again.yaml").serial_number == unit


def test_a_compensation_is_read_as_it_was_written(tmp_path):
    random = np.random.default_rng(2)
    numbers = {name: random.uniform(1.0, 2.0, 3) for name in PARAMETER_NAMES}
    for name in ("saturating_dph_per_k", "growing_dph_per_k", "gravity_dph_per_g"):
        numbers[name] = random.normal(size=(3, 3))
    numbers |= {"polynomial_dph": random.normal(size=(3, 4)), "high_c": np.full(3, 60.0)}
    numbers["difference_high_k"] = np.full(3, 30.0)
    path = tmp_path / "compensation.yaml"
    sigma = {name: 0.1 * np.abs(numbers[name]) for name in get_args(_NumberName)}
    write_compensation(path, Compensation(**numbers, sigma=sigma))
    read = read_compensation(path)
    for name, value in numbers.items():
        np.testing.assert_array_equal(getattr(read, name), value)
    assert read.sigma.keys() == sigma.keys()
    for name, value in sigma.items():
        np.testing.assert_array_equal(read.sigma[name], value)


def test_terms_that_are_not_used_are_left_out(tmp_path, written):
    path = tmp_path / "polynomial.yaml"
    write_compensation(path, read_compensation(written(POLYNOMIAL)))
    assert "warm_up" not in path.read_text()
    assert read_compensation(path).terms() == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            f"{POLYNOMIAL}difference_low_k: [5, 5, 5]\ndifference_high_k: [6, 4, 6]\n",
            "difference_low_k must not be above difference_high_k",
        ),
        (
            POLYNOMIAL + "warm_up_dph: [1, 2, 3]\nwarm_up_s: [-1, 0, 1]\n",
            "warm_up_dph needs warm_up_s above zero",
        ),
        (POLYNOMIAL.replace("[1.0]", "[1.0, 2.0]"), "as many coefficients for each gyro"),
        (
            POLYNOMIAL.replace("low_c: [-20, -20, -20]", "low_c: [-20, 90, -20]"),
            "low_c must not be above high_c",
        ),
        (POLYNOMIAL + "gravity: [1, 2, 3]\n", "unknown key 'gravity'"),
        (POLYNOMIAL + "warm_up_dph: [1, 2]\n", "at least 3 items"),
        ("low_c: [1, 2, 3]\n", "polynomial_dph"),
        (POLYNOMIAL + "sigma: {low_c: [1, 1, 1]}\n", "low_c"),
        (
            POLYNOMIAL + "sigma: {polynomial_dph: [[0.1], [-0.2], [0.3]]}\n",
            "sigma of polynomial_dph must have as many numbers as polynomial_dph, none below zero",
        ),
        (
            POLYNOMIAL + "sigma: {polynomial_dph: [[0.1, 1], [0.2, 1], [0.3, 1]]}\n",
            "must have as many numbers",
        ),
        (POLYNOMIAL + "sigma: {warm_up_dph: [0.1, 0.2]}\n", "at least 3 items"),
    ],
)
def test_mistakes_are_shown_with_their_place(written, text, message):
    with pytest.raises(DocumentError, match=message) as caught:
        read_compensation(written(text))
    assert re.match(r".*compensation\.yaml:\d+:\d+: ", str(caught.value))


def test_the_temperatures_of_a_coefficient_are_read_as_written_and_in_order(tmp_path, written):
    path = tmp_path / "compensation.yaml"
    correction = Correction(np.array([3.0, 0.1]), range_c=(33.0, 75.0))
    numbers = read_compensation(written(POLYNOMIAL))
    write_compensation(path, replace(numbers, coefficients={"gyro_scale_factor_x": correction}))
    assert read_compensation(path).coefficients["gyro_scale_factor_x"].range_c == (33.0, 75.0)
    path.write_text(path.read_text().replace("[33.0, 75.0]", "[75.0, 33.0]"))
    with pytest.raises(DocumentError, match="low_c of a coefficient must not be above its high_c"):
        read_compensation(path)


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ({"in_use": {"active": True, "checksum": "0badcafe"}, "terms": None}, ["0badcafe"]),
        ({"in_use": {"active": False, "checksum": "00000000"}, "terms": None}, []),
        ({"in_use": {"active": None, "checksum": None}, "terms": None}, []),
        ({"in_use": {"active": None, "checksum": None}, "terms": []}, ["checksum unknown"]),
    ],
)
def test_a_loaded_compensation_is_in_use_though_the_ins_does_not_report_it(tmp_path, entry, expected):
    run = RunFolder(tmp_path)
    run.journal.write_text(json.dumps({"event": "compensation", **entry}) + "\n")
    assert compensations_in_use(run) == expected
