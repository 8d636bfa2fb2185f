import math
from dataclasses import replace

from gyrobench.bench.monitor.rows import bin_tables, reading_rows, shown_dwells
from tests.bench.live.made_up_picture import bins_of, dwells_done, made_up_picture


def test_bins_are_told_by_gyro_with_the_warmest_first_and_empty_ranges_as_one():
    x, y, z = bin_tables(made_up_picture().bins)
    assert (x.gyro, y.gyro, z.gyro) == ("X gyro", "Y gyro", "Z gyro")
    assert x.unit == "0.001 deg/h"
    assert x.positions == ("Z-Up", "Z-Down", "Y-Up", "Y-Down", "X-Up", "X-Down")
    assert [label for label, _ in x.rows] == ["70…75", "35…70", "30…35", "5…30", "0…5"]
    assert [len(cells) for _, cells in x.rows] == [6, 0, 6, 0, 6]
    assert (x.rows[0][1][0].bias, x.rows[0][1][0].sigma) == ("3.0", "1.1")


def test_a_flagged_dwell_is_in_no_bin():
    warmest = bin_tables(made_up_picture().bins)[0].rows[0][1]
    assert [cell.count for cell in warmest] == [1, 1, 1, 1, 0, 1]


def test_bins_below_zero_have_true_minus_signs():
    labels = [label for label, _ in bin_tables(bins_of(dwells_done(24)))[0].rows]
    assert labels[-1] == "−30…−25"


def test_no_bins_where_no_dwell_counts():
    assert bin_tables(()) == []
    assert bin_tables(bins_of(())) == []


def test_dwells_come_with_the_newest_first():
    table = shown_dwells(dwells_done(13))
    assert [row.number for row in table.rows] == list(range(13, 0, -1))
    newest, flagged = table.rows[0], table.rows[13 - 5]
    assert (newest.position, newest.temperature) == ("Z-Up", "3.1")
    assert [cell.bias for cell in newest.cells] == ["3.0", "0.0", "1.5"]
    assert flagged.flags == "the INS left navigation in the turn"
    assert [cell.count for cell in flagged.cells] == [0, 0, 0]


def test_readings_are_told_with_their_age():
    rows = {what: (value, age) for what, value, age in reading_rows(made_up_picture().bench)}
    assert rows["chamber air"] == ("−9.80 °C", "0.6 s")
    assert rows["gyro optics x, y, z"] == ("4.10, 4.90, 3.60 °C", "0.0 s")
    assert rows["table inner axis"] == ("180.000°, 0.00 deg/s", "0.4 s")


def test_readings_that_are_not_known_say_so():
    nan = math.nan
    silent = replace(
        made_up_picture().bench, gyro_c=(nan,) * 3, electronics_c=(nan, 12.0, nan), case_c=nan, outer_deg=nan,
        outer_rate_dps=nan, chamber_set_c=nan, ins_age_s=nan,
    )  # fmt: skip
    rows = {what: (value, age) for what, value, age in reading_rows(silent)}
    assert rows["gyro optics x, y, z"] == ("not known", "never")
    assert rows["electronics x, y, z"] == ("–, 12.00, – °C", "never")
    assert rows["table outer axis"] == ("not known", "0.4 s")
    assert rows["chamber set"] == ("not controlled", "0.6 s")
    assert not any("nan" in value for value, _ in rows.values())
