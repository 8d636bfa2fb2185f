from dataclasses import replace

from gyrobench.bench.bias.verdicts import Acceptance, AcceptanceLimits
from gyrobench.bench.report.bias_sections import before_after_section
from gyrobench.bench.report.run_content import RunContent


def content(name, dwells, bins):
    return RunContent(
        name=name, journal=[], provenance={}, procedure={}, station={}, dwells=dwells, bins=bins, telemetry={}
    )


def test_each_gyro_has_both_runs_on_one_scale(dwells, bins, equal_dwells, equal_bins):
    section = before_after_section(content("old", dwells, bins), content("new", equal_dwells, equal_bins))
    assert [drawn.name for drawn in section.figures] == ["before_after_x", "before_after_y", "before_after_z"]
    for drawn in section.figures:
        before, after = drawn.figure().axes
        assert before.get_ylim() == after.get_ylim()
        assert before.get_xlim() == after.get_xlim()
        assert len(before.containers) == len(after.containers) == 6
        assert "deg/h" in before.get_ylabel()


def test_the_table_states_the_largest_difference_of_each_run(dwells, bins, equal_dwells, equal_bins):
    section = before_after_section(content("old", dwells, bins), content("new", equal_dwells, equal_bins))
    (table,) = section.tables
    differences = [float(row[-1].split()[0]) for row in table.rows]
    assert [row[:2] for row in table.rows[:2]] == [["X gyro", "before"], ["X gyro", "after"]]
    assert all(
        before > 4.0 * after for before, after in zip(differences[::2], differences[1::2], strict=True)
    )


def test_the_earlier_run_is_named_with_its_verdict(dwells, bins):
    old = content("old", dwells, bins)
    limits = AcceptanceLimits(position_difference_dph=0.006)
    judged = replace(old, acceptance=Acceptance(verdict="rejected", limits=limits))
    assert "run old, unit rejected." in before_after_section(judged, old).paragraphs[0]


def test_runs_of_two_units_are_stated_as_such(dwells, bins):
    others = [replace(row, unit="1002") for row in dwells]
    section = before_after_section(content("old", dwells, bins), content("new", others, bins))
    assert section.paragraphs[1] == "The runs are of different units: 1001 before, 1002 after."


def test_a_run_that_began_later_or_was_edited_is_stated_as_such(dwells, bins):
    runs = [
        replace(content(name, dwells, bins), provenance={"started_utc": f"{day}T08:30:00+00:00"})
        for name, day in (("first", "2026-03-01"), ("second", "2026-03-02"))
    ]
    assert len(before_after_section(*runs).paragraphs) == 1
    edited = replace(runs[1], damage={"dwells.csv": "dwells.csv: has changed since it was sealed."})
    assert before_after_section(edited, runs[0]).paragraphs[1:] == [
        "Run second began later, 2026-03-02 08:30 UTC, than this run, 2026-03-01 08:30 UTC.",
        "dwells.csv: has changed since it was sealed.",
    ]


def test_a_run_without_bins_has_nothing_to_compare(dwells, bins):
    section = before_after_section(content("old", [], []), content("new", dwells, bins))
    assert section.tables[0].rows[0] == ["X gyro", "before", "", "nothing to compare", ""]
