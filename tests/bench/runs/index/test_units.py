"""The table of units that people keep."""

import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.runs.index.tables import UnitRow, parse_units


def test_a_table_needs_unit_and_batch_alone():
    assert parse_units("batch,unit\nB7,1001\n", "units.csv") == [UnitRow("1001", "B7", "", "")]
    assert parse_units("unit,batch,hardware,note\n1,B,2,new optics\n", "units.csv")[0].note == "new optics"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("unit\n1\n", "batch"),
        ("unit,batch\n1,A\n1,B\n", "units.csv:3.*unit 1 is also in line 2"),
        ("unit,batch\n=1+1,A\n", "can't begin with '='"),
        ("unit,batch\n1\n", "units.csv:2"),
    ],
)
def test_mistakes_are_reported_with_their_place(text, message):
    with pytest.raises(DocumentError, match=message):
        parse_units(text, "units.csv")
