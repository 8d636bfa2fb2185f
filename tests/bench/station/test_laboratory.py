"""Laboratory and calibrations in the station file; instruments past due need an acknowledgement."""

from datetime import UTC, date, datetime, timedelta

import pytest

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.preflight.bench_check import calibration_checks
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station.check_result import CheckVerdict
from gyrobench.bench.station.station import Station

SECTIONS = """
laboratory: {name: Example Laboratory, street: Long Road 1, city: Sampletown, country: DE}
traceability:
  rate_table:
    serial_number: RT-17
    certificate: 2026-0815
    calibrated: 2020-01-15
    due: %s
    uncertainty: {value: 0.5, unit: arcsec}
"""


@pytest.fixture
def station_file(tmp_path):
    def write(due):
        path = tmp_path / "station.yaml"
        path.write_text(find_document("stations", "emulated").read_text() + SECTIONS % due)
        return path

    return write


def today():
    return datetime.now(UTC).date()


def test_the_laboratory_and_the_calibrations_are_read(station_file):
    file = Station(station_file("2030-12-31")).file
    assert file.laboratory.address == "Long Road 1, Sampletown, DE"
    ((name, table),) = file.traceability.instruments()
    assert (name, table.due, table.uncertainty.text) == (
        "rate_table",
        date(2030, 12, 31),
        "0.5 arcsec (k = 2)",
    )


def test_an_instrument_is_past_due_the_day_after(station_file):
    traceability = Station(station_file("2026-05-01")).file.traceability
    assert traceability.past_due(date(2026, 5, 1)) == {}
    assert traceability.past_due(date(2026, 5, 3)) == {
        "rate_table": "calibration of the rate table RT-17 was due on 2026-05-01, 2 days ago"
    }


def test_a_run_with_an_instrument_past_due_needs_the_operators_acknowledgement(station_file, monkeypatch):
    monkeypatch.setenv("GYROBENCH_OPERATOR", "A. Smith")
    station = station_file(today() - timedelta(days=9))
    with pytest.raises(DocumentError, match=r"9 days ago.*run with --acknowledge rate_table"):
        prepare_job("ten_minute_check", str(station)).check_calibrations()
    prepare_job("ten_minute_check", str(station), acknowledged=["rate_table"]).check_calibrations()
    (check,) = calibration_checks(Station(station), [])
    assert check.verdict is CheckVerdict.FAIL
    (check,) = calibration_checks(Station(station), ["rate_table"])
    assert check.verdict is CheckVerdict.PASS
    assert check.found.endswith("acknowledged by A. Smith")


@pytest.mark.parametrize(
    ("due", "message"), [("31.12.2030", "is not a date; write it as 2026-01-31"), ("", "is not a date")]
)
def test_what_is_no_date_is_refused_with_its_place(station_file, due, message):
    with pytest.raises(DocumentError, match=message):
        Station(station_file(f'"{due}"'))
