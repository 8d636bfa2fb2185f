"""Shipped files by name."""

from gyrobench.bench.foundations.shipped import find_document


def test_the_old_name_of_a_shipped_file_is_accepted_with_a_note(caplog):
    assert find_document("procedures", "verification") == find_document("procedures", "calibration_check")
    assert "verification: this procedure is called calibration_check" in caplog.text
