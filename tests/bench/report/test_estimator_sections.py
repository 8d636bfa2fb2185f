"""What the report says of the estimators."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.report.estimator_sections import estimators_note, estimators_section, fit_section


def test_table_names_the_dwell_in_which_the_estimators_differ_most(dwells: list[DwellRow]) -> None:
    x, y, z = dwells[20].bias_dph
    apart = replace(dwells[20], paper_bias_dph=(x, y - 0.05, z))
    section = estimators_section([*dwells[:20], apart])
    assert section is not None
    (table,) = section.tables
    assert [row[0] for row in table.rows] == ["X gyro", "Y gyro", "Z gyro"]
    assert table.rows[1][1] == f"Y-Up, {apart.gyro_c[1]:.0f} °C, dwell 21"
    assert table.rows[1][3].startswith("-50.0 ± 1.")
    assert all(len(row) == len(table.header) for row in table.rows)


def test_rms_is_that_of_the_leaks(dwells: list[DwellRow]) -> None:
    section = estimators_section(dwells)
    assert section is not None
    assert [float(row[2]) for row in section.tables[0].rows] == pytest.approx([3.3] * 3, abs=0.3)


def test_single_dwell_has_a_table_and_no_picture(dwells: list[DwellRow]) -> None:
    section = estimators_section(dwells[:1])
    assert section is not None
    assert section.figures == []
    assert section.tables[0].caption.endswith("over 1 dwell")
    both = estimators_section(dwells[:2])
    assert both is not None
    assert len(both.figures) == 1


@pytest.mark.parametrize(("count", "has_band"), [(4, False), (5, True)])
def test_caption_of_the_fit_states_what_is_drawn(dwells: list[DwellRow], count: int, has_band: bool) -> None:
    section = fit_section(dwells[:count])
    assert section is not None
    (drawn,) = section.figures
    assert ("a probability of 1 %" in drawn.caption) is has_band
    assert ("Right:" in drawn.caption) is has_band


def test_sections_are_there_where_there_is_something_to_say(
    dwells: list[DwellRow], old_dwells: list[DwellRow]
) -> None:
    assert estimators_section(old_dwells) is None
    assert fit_section(old_dwells) is None
    assert fit_section(dwells) is not None
    assert estimators_section([]) is None
    assert estimators_note([]) == ""
