import re
from pathlib import Path

import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station.interlocks import (
    CHAMBER_OUT_OF_CONTROL,
    FORBID_MANUAL_CHAMBER,
    FORBID_MANUAL_MOTION,
    INS_MAY_BE_OFF,
)
from gyrobench.bench.station.station_file import load_station_file


def loaded(tmp_path, more="", name="emulated"):
    path = tmp_path / "station.yaml"
    path.write_text(find_document("stations", name).read_text() + more)
    return load_station_file(path)[1]


@pytest.mark.parametrize("name", ["emulated", "quick", "example_bench"])
def test_the_defaults_follow_from_the_limits_that_the_file_has(tmp_path, name):
    file = loaded(tmp_path, name=name)
    limits = file.chamber.limits
    assert file.interlocks.chamber_air.range_c((limits.low_c, limits.high_c)) == (-55.0, 80.0)
    assert file.interlocks.outer_angle.range_deg(file.rate_table.limits.outer_deg) == (-201.0, 201.0)
    ramp = file.interlocks.gyro_rate.limit_or_default_c_per_min(limits.ramp_c_per_min)
    assert ramp == 1.5 * limits.ramp_c_per_min + 2.0
    assert file.interlocks.table_silence.limit_or_default_s(5.0) == 30.0
    assert file.interlocks.table_silence.limit_or_default_s(20.0) == 80.0


def test_what_may_pass_goes_on_by_itself_and_the_rest_needs_a_person(tmp_path):
    rules = loaded(tmp_path).interlocks.rules()
    assert {name for name, rule in rules.items() if rule.resume == "automatic"} == {
        "chamber_air_rate", "case_rate", "gyro_rate", "table_silence", "chamber_silence", "ins_silence",
        "chamber_deviation",
    }  # fmt: skip
    assert loaded(tmp_path).interlocks.max_hold_s == 24 * 3600.0


def test_the_page_explains_every_interlock_and_each_special_rule_names_one(tmp_path):
    page = (Path(__file__).parents[3] / "docs" / "interlocks.md").read_text(encoding="utf-8")
    table = page[page.index("| Interlock |") :].partition("\n\n")[0]
    names = loaded(tmp_path).interlocks.rules().keys()
    assert names == {name for row in table.splitlines() for name in re.findall("`(.*?)`", row.split("|")[1])}
    special = CHAMBER_OUT_OF_CONTROL | INS_MAY_BE_OFF | FORBID_MANUAL_MOTION | FORBID_MANUAL_CHAMBER
    assert special <= names


WRONG = {
    "chamber_air: {high_c: 70}": "interlocks.chamber_air trips outside -55 to 70 degC, within the limits",
    "outer_angle: {low_deg: -10}": "interlocks.outer_angle trips outside -10 to 201 deg",
    "chamber_air_rate: {limit_c_per_min: 3}": "interlocks.chamber_air_rate trips above 3 degC/min",
    "table_rate: {limit_dps: 20}": "interlocks.table_rate trips above 20 deg/s, within the limit of 30 deg/s",
    "case_temperature: {low_c: 50, high_c: 40}": r"low_c \(50\) must be below high_c \(40\)",
    "chamber_air: {resume: a person}": "person",
    "chamber_door: {}": "unknown key 'chamber_door'",
    "ins_silence: {limit_s: 0}": "above 0",
    "gyro_rate: {max_resumes: -1}": "at least 0",
}


@pytest.mark.parametrize(("line", "message"), WRONG.items())
def test_mistakes_are_reported_with_their_place(tmp_path, line, message):
    with pytest.raises(DocumentError, match=rf"station.yaml:\d+:\d+: .*{message}"):
        loaded(tmp_path, f"\ninterlocks:\n  {line}\n")
