"""Campaigns from dwell tables and run folders."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import UNKNOWN_UNIT, write_dwells
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.laws import BIAS_JUMP, THERMAL_LAG, TIME_DRIFT, WARM_UP
from gyrobench.bench.closure.inputs import (
    ASSUMED_PAUSE_S,
    TableToJoin,
    join_tables,
    read_campaign,
    temperature_record,
)
from gyrobench.bench.closure.loop import close_loop, hold_out_each
from gyrobench.bench.closure.temperature_record import TemperatureRecord
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError, RunFolderError
from gyrobench.bench.runs.telemetry import TELEMETRY_COLUMNS, Telemetry
from tests.bench.closure.thermal_bench import measure
from tests.bench.report.made_up_closure import made_up_rows


def readings(count=200, step_s=10.0):
    values = {name: np.zeros(count) for name in TELEMETRY_COLUMNS}
    values["time_s"] = step_s * np.arange(count)
    for axis, name in enumerate(("gyro_x_c", "gyro_y_c", "gyro_z_c")):
        values[name] = 20.0 + axis + 0.01 * values["time_s"]
    return values


def write_run(folder, values):
    (folder / "journal.jsonl").write_text("")
    write_dwells(folder / "dwells.csv", made_up_rows())
    telemetry = Telemetry(folder / "telemetry")
    for row in zip(*values.values(), strict=True):
        telemetry.add(dict(zip(values, row, strict=True)))
    telemetry.flush()


def test_a_table_gives_its_dwells(tmp_path):
    write_dwells(tmp_path / "dwells.csv", made_up_rows())
    assert len(read_campaign(tmp_path / "dwells.csv")) == len(made_up_rows())


def test_a_run_gives_its_temperatures_between_the_dwells_too(tmp_path):
    write_run(tmp_path, readings())
    record = read_campaign(tmp_path).record
    assert record.time_s[[0, -1]] == pytest.approx([0.0, 1990.0])
    assert record.gyro_c == pytest.approx(20.0 + np.arange(3) + 0.01 * record.time_s[:, np.newaxis])
    assert np.ptp(np.diff(record.time_s)) < 1e-6


def test_a_run_without_readings_falls_back_on_its_dwells(tmp_path):
    write_run(tmp_path, {name: np.empty(0) for name in TELEMETRY_COLUMNS})
    record = read_campaign(tmp_path).record
    assert record.time_s[-1] == pytest.approx(made_up_rows()[-1].end_s)


def test_readings_without_a_number_are_bridged():
    values = readings()
    values["gyro_y_c"][50:120] = np.nan
    record = temperature_record(values)
    assert record.gyro_c[:, 1] == pytest.approx(21.0 + 0.01 * record.time_s)


def test_a_gyro_that_was_never_read_gives_no_record():
    values = readings()
    values["gyro_z_c"][:] = np.nan
    assert temperature_record(values) is None


def test_a_long_run_has_a_record_of_bounded_size():
    record = temperature_record(readings(count=2000, step_s=3600.0))
    assert len(record.time_s) <= 20_001


def test_a_folder_that_is_no_run_is_reported(tmp_path):
    with pytest.raises(RunFolderError, match="is not a run folder"):
        read_campaign(tmp_path)


def test_a_run_that_is_not_there_is_reported_with_one_of_a_similar_name(tmp_path):
    (tmp_path / "first").mkdir()
    with pytest.raises(RunFolderError, match=r"frist: no such folder \(did you mean 'first'"):
        read_campaign(tmp_path / "frist")


def test_a_table_that_is_not_there_is_reported(tmp_path):
    with pytest.raises(DocumentError, match=r"nothing\.csv"):
        read_campaign(tmp_path / "nothing.csv")


def test_a_table_without_dwells_is_refused(tmp_path):
    write_dwells(tmp_path / "dwells.csv", [])
    with pytest.raises(MeasurementError, match=r"dwells\.csv: has no dwells"):
        read_campaign(tmp_path / "dwells.csv")


def moved(rows, shift_s=0.0, **changes):
    """Rows on another clock."""
    return [replace(row, start_s=row.start_s + shift_s, end_s=row.end_s + shift_s, **changes) for row in rows]


def source(name, rows, record=None, **options):
    return TableToJoin(name, campaign_of(rows, record), **options)


@pytest.fixture(scope="module")
def rows():
    return measure({"temperature_rate": 2.0}, cycles=3, power_on_each_cycle=True, dwell_s=1680.0).rows


@pytest.fixture(scope="module")
def halves(rows):
    """First cycle, and the two others as a table with the same clock."""
    return [[row for row in rows if (row.cycle > 1) is later] for later in (False, True)]


def same(one, other):
    for name in ("dwell", "cycle", "run", "start_s", "end_s", "since_power_on_s", "bias_dph", "position"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def test_a_table_cut_in_two_is_the_same_campaign_in_any_order(rows, halves):
    first, second = (source(name, part) for name, part in zip("ab", halves, strict=True))
    for given in ([first, second], [second, first]):
        campaign = join_tables(given)
        same(campaign, campaign_of(rows))
        assert [table.name for table in campaign.tables] == ["a", "b"]
        assert campaign.tables[1].placed == "on the clock of a"
    np.testing.assert_array_equal(campaign.power_on_s, campaign_of(rows).power_on_s)


def test_a_cut_within_a_power_cycle_leaves_one_constant(rows):
    campaign = join_tables([source("a", rows[:20]), source("b", rows[20:])])
    assert campaign.run_names == campaign_of(rows).run_names
    same(campaign, campaign_of(rows))


def test_a_table_with_its_own_clock_comes_after_the_one_before_it_with_unique_numbers(halves):
    first, second = halves
    shift_s = first[0].start_s - second[0].start_s
    again = [
        replace(row, dwell=index + 1, cycle=row.cycle - 1)
        for index, row in enumerate(moved(second, shift_s, run=first[0].run))
    ]
    campaign = join_tables([source("a", first), source("b", again)])
    begins_s = campaign.start_s[len(first)]
    assert begins_s == pytest.approx(first[-1].end_s + ASSUMED_PAUSE_S + second[0].since_power_on_s, abs=1e-6)
    assert len(set(campaign.dwell.tolist())) == len(campaign)
    assert campaign.cycles == [1, 2, 3]
    assert campaign.tables[1].cycles == (2, 3)
    assert campaign.tables[1].placed == "after a: it has no common clock with it"
    assert campaign.run_names[:2] == (first[0].run, f"{first[0].run} (b)")
    assert np.all(np.diff(campaign.start_s) > 0.0)
    np.testing.assert_array_equal(
        np.diff(campaign.start_s[len(first) :]), np.diff([r.start_s for r in again])
    )


def test_runs_are_placed_by_their_calendar_time_in_any_order(halves):
    first, second = halves
    zero = moved(second, first[0].start_s - second[0].start_s)
    a = source("a", first, is_run=True, began_s=5e5)
    b = source("b", zero, is_run=True, began_s=5e5 + 3e5)
    for given in ([a, b], [b, a]):
        campaign = join_tables(given)
        assert campaign.start_s[len(first)] - campaign.start_s[0] == pytest.approx(3e5)
        assert campaign.tables[1].placed == "by its calendar time"


@pytest.mark.parametrize("options", [{"clock": "virtual"}, {"clock": "wall", "speed": 10.0}])
def test_emulated_runs_that_are_faster_than_real_time_have_no_calendar(tmp_path, halves, options):
    for name, rows in zip("ab", halves, strict=True):
        (tmp_path / name).mkdir()
        write_run(tmp_path / name, {column: np.empty(0) for column in TELEMETRY_COLUMNS})
        write_dwells(tmp_path / name / "dwells.csv", moved(rows, -rows[0].start_s))
        provenance = {"started_utc": "2026-03-01T00:00:00+00:00", "options": options}
        (tmp_path / name / "provenance.json").write_text(json.dumps(provenance))
    campaign = read_campaign(tmp_path / "a", tmp_path / "b")
    assert campaign.tables[1].placed == f"after {tmp_path / 'a'}: it has no common clock with it"


def test_runs_that_overlap_are_refused_by_name(halves):
    first, second = halves
    zero = moved(second, first[0].start_s - second[0].start_s)
    with pytest.raises(MeasurementError, match=r"^b starts 17\..* h before a ends"):
        join_tables(
            [source("a", first, is_run=True, began_s=0.0), source("b", zero, is_run=True, began_s=3600.0)]
        )


def test_other_units_and_dwells_given_twice_are_refused_by_name(rows, halves):
    other = [replace(row, unit="other") for row in halves[1]]
    with pytest.raises(MeasurementError, match="b is of unit other, a of unit"):
        join_tables([source("a", halves[0]), source("b", other)])
    with pytest.raises(MeasurementError, match="b: 20 of its dwells, the first is number 1, are also in a"):
        join_tables([source("a", rows[:20]), source("b", rows)])


def test_tables_that_may_be_of_another_unit_or_firmware_state_that(halves):
    known = [
        source(name, part, ins="serial number 7, firmware 1") for name, part in zip("ab", halves, strict=True)
    ]
    assert [table.doubt for table in join_tables(known).tables] == ["", ""]
    known[1] = replace(known[1], ins="serial number 7, firmware 2")
    assert "firmware 2, that of a as serial number 7, firmware 1" in join_tables(known).tables[1].doubt
    nameless = [source(name, moved(part, unit=UNKNOWN_UNIT)) for name, part in zip("ab", halves, strict=True)]
    doubts = [table.doubt for table in join_tables(nameless).tables]
    assert doubts == ["", "without a serial number: taken for the unit of a"]


def test_effects_with_a_memory_are_those_of_each_table_alone(halves):
    """In a pause of weeks the memory of the table before it is lost."""
    first, second = (source(name, part) for name, part in zip("ab", halves, strict=True))
    weeks_s = 3e6
    later = source("b", moved(halves[1], weeks_s))
    campaign = join_tables([first, later])
    lag, decay = THERMAL_LAG.forms[0], WARM_UP.forms[0]
    for form, tolerance in ((lag, 0.02), (decay, 1e-9)):
        columns = form.columns(campaign, (3600.0,))
        np.testing.assert_allclose(
            columns[: len(halves[0])], form.columns(first.campaign, (3600.0,)), atol=1e-9
        )
        alone = form.columns(second.campaign, (3600.0,))
        # The temperature of the pause is a straight line: at rest at the table's first temperature.
        np.testing.assert_allclose(columns[len(halves[0]) :], alone, atol=tolerance * np.abs(alone).max())


def test_a_recorded_course_is_kept_and_one_of_dwells_does_not_see_what_is_held_out(halves):
    first, second = halves
    time_s = np.linspace(first[0].start_s, first[-1].end_s, 500)
    measured = TemperatureRecord(time_s, np.stack([20.0 + 1e-4 * time_s] * 3, axis=1))
    hot = [replace(row, gyro_c=tuple(np.add(row.gyro_c, 40.0 * (row.cycle == 3)))) for row in second]
    records = []
    for part in (second, hot):
        campaign = join_tables([source("a", first, measured), source("b", part)]).holding_out([3])
        records.append(campaign.record)
        inside = campaign.record.time_s < first[-1].end_s
        np.testing.assert_array_equal(campaign.record.gyro_c[inside], measured.gyro_c[:-1])
    seen = (records[0].time_s > second[0].start_s) & (
        records[0].time_s < max(row.end_s for row in second if row.cycle == 2)
    )
    assert seen.sum() > 100
    np.testing.assert_array_equal(records[0].gyro_c[seen], records[1].gyro_c[seen])


def test_the_cycle_held_out_is_the_last_one_of_the_first_table_with_several(rows):
    parts = [[row for row in rows if row.cycle < 3], [row for row in rows if row.cycle == 3]]
    campaign = join_tables([source("a", parts[0]), source("b", parts[1])])
    assert campaign.last_cycle == 2
    assert join_tables([source("b", parts[1]), source("a", moved(parts[0], 1e6))]).last_cycle == 5
    assert campaign.cycles_of("b") == [3]
    with pytest.raises(
        MeasurementError, match=r"c can't be held out: it is not searched\. Name one of a and b"
    ):
        campaign.cycles_of("c")


def test_what_one_power_cycle_leaves_tied_a_second_table_settles():
    """Warm-up and drift in one power-on: a day later, after another power-on, they differ."""
    effects = [BIAS_JUMP, TIME_DRIFT, WARM_UP]

    def warm(course):
        return np.exp(-course.since_power_on_h / 12.0)[:, np.newaxis]

    one = measure({warm: 2.5}, cycles=2, sensors=("set",)).rows
    two = measure({warm: 2.5}, cycles=2, sensors=("set",), seed=5).rows
    alone = close_loop(campaign_of(one), effects=effects)
    assert alone.verdict == "ambiguous"
    together = close_loop(join_tables([source("a", one), source("b", two, is_run=True)]), effects=effects)
    assert [found.effect.name for found in together.effects] == ["warm_up"]
    assert together.effects[0].tied_with == ()


def test_each_cycle_is_held_out_in_turn(rows):
    closure = hold_out_each(close_loop(campaign_of(rows), effects=[TIME_DRIFT, WARM_UP]))
    assert [turn.cycle for turn in closure.held_out_in_turn] == [1, 2, 3]
    last = closure.held_out_in_turn[-1]
    assert (last.verdict, last.error_before_dph) == (closure.verdict, closure.error_before_dph)
    alone = close_loop(campaign_of(rows), [1], [TIME_DRIFT, WARM_UP])
    assert closure.held_out_in_turn[0].error_after_dph == alone.error_after_dph
    assert closure.held_out_in_turn[0].error_before_dph != last.error_before_dph


def test_a_cycle_without_which_too_little_is_left_is_listed_with_the_reason(rows):
    short = [row for row in rows if row.cycle == 1] + [row for row in rows if row.cycle == 2][:6]
    closure = hold_out_each(close_loop(campaign_of(short), [2], [TIME_DRIFT]))
    assert [bool(turn.verdict) for turn in closure.held_out_in_turn] == [False, True]
    assert "degrees of freedom" in closure.held_out_in_turn[0].reason
