import math
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.bias.dwell_table import (
    COLUMNS,
    DwellRow,
    PackedDwells,
    format_dwells,
    paper_rows,
    parse_dwells,
    read_dwells,
    read_packed_dwells,
    write_dwells,
)
from gyrobench.bench.foundations.errors import DocumentError, RunFolderError
from gyrobench.bench.navigation.positions import POSITIONS

CASES = Path(__file__).parents[4] / "shared" / "cases" / "dev"

ROW = DwellRow(
    unit="U7",
    run="R1",
    dwell=3,
    cycle=0,
    position="y_up",
    start_s=1800.25,
    end_s=3040.5,
    since_power_on_s=5400.0,
    gyro_c=(25.5, 26.0, 26.5),
    gyro_rate_c_per_h=(0.1, -0.2, 0.3),
    bias_dph=(0.0123456789, -0.002, 1e-7),
    sigma_dph=(0.0024, 0.0019, 0.0024),
)

numbers = st.floats(-1e6, 1e6)
temperatures = st.floats(-273.15, 1000.0)
maybe = numbers | st.just(math.nan)
texts = st.text(st.characters(exclude_categories=["Cc", "Cs", "Z"]), max_size=8)
names = texts.filter(lambda text: not text.startswith(("=", "+", "-", "@")))


def triples(values):
    return st.tuples(values, values, values)


dwell_rows = st.builds(
    DwellRow,
    unit=names,
    run=names,
    dwell=st.integers(0, 10**9),
    cycle=st.integers(0, 1000),
    position=st.sampled_from(list(POSITIONS)),
    start_s=st.floats(0.0, 1e5),
    end_s=st.floats(1.1e5, 1e6),
    since_power_on_s=numbers,
    gyro_c=triples(temperatures),
    gyro_rate_c_per_h=triples(numbers),
    bias_dph=triples(numbers),
    sigma_dph=triples(st.floats(1e-9, 1.0)),
    chamber_set_c=maybe,
    chamber_c=maybe,
    case_c=maybe,
    board_c=triples(maybe),
    paper_bias_dph=triples(maybe),
    paper_sigma_dph=triples(st.floats(1e-9, 1.0) | st.just(math.nan)),
    accelerometer_ug=triples(maybe),
    accelerometer_sigma_ug=triples(st.floats(1e-9, 1e3) | st.just(math.nan)),
    accelerometer_common_sigma_ug=triples(st.floats(0.0, 1e3) | st.just(math.nan)),
    fit_ratio=maybe,
    fit_p_value=maybe,
    flags=st.lists(texts.filter(bool), max_size=2).map(tuple),
)


@given(st.lists(dwell_rows, max_size=5, unique_by=lambda row: row.dwell))
def test_reading_and_writing_again_gives_the_same_text(rows):
    text = format_dwells(rows)
    read = parse_dwells(text, "dwells.csv")
    assert format_dwells(read) == text
    assert [len(row.flags) for row in read] == [len(row.flags) for row in rows]


def test_a_flag_with_a_semicolon_stays_one_flag():
    flags = ("only 12 epochs; a window needs 30", "door opened")
    (row,) = parse_dwells(format_dwells([replace(ROW, flags=flags)]), "x")
    assert row.flags == ("only 12 epochs, a window needs 30", "door opened")


@given(st.text(max_size=300))
def test_any_text_is_read_or_refused(text):
    with suppress(DocumentError):
        parse_dwells(text, "dwells.csv")


@given(st.sampled_from(COLUMNS), st.text(max_size=10))
def test_any_cell_is_read_or_refused(column, text):
    cell = '"' + text.replace('"', '""') + '"'
    cells = format_dwells([ROW]).splitlines()[1].split(",")
    cells[COLUMNS.index(column)] = cell
    with suppress(DocumentError):
        (row,) = parse_dwells(",".join(COLUMNS) + "\n" + ",".join(cells) + "\n", "dwells.csv")
        assert row.position in POSITIONS
        assert min(row.sigma_dph) > 0.0
        assert not any(sigma <= 0.0 for sigma in row.paper_sigma_dph)


def test_a_row_survives_the_file(tmp_path):
    path = tmp_path / "dwells.csv"
    write_dwells(path, [ROW])
    (read,) = read_dwells(path)
    for field in fields(DwellRow):
        assert getattr(read, field.name) == pytest.approx(getattr(ROW, field.name), nan_ok=True)
    assert path.read_bytes().count(b"\r") == 0


@pytest.mark.parametrize("text", ["a\rb", "a\nb", "a\r\nb"])
def test_an_end_of_line_in_a_cell_makes_no_other_row(text):
    [row] = parse_dwells(format_dwells([replace(ROW, flags=(text,))]), "dwells.csv")
    assert row.flags == (text,)


@given(st.lists(dwell_rows, max_size=4))
def test_packed_rows_are_the_same_rows(rows):
    packed = PackedDwells(rows)
    assert len(packed) == len(rows)
    assert format_dwells(packed) == format_dwells(rows)
    assert [repr(each) for each in packed[1:]] == [repr(each) for each in rows[1:]]
    if rows:
        assert repr(packed[-1]) == repr(rows[-1])
    with pytest.raises(IndexError):
        packed[len(rows)]


def test_packed_rows_are_read_and_refused_as_others(tmp_path):
    path = tmp_path / "dwells.csv"
    write_dwells(path, [ROW, replace(ROW, dwell=4)])
    assert format_dwells(read_packed_dwells(path)) == path.read_text(encoding="utf-8")
    write_dwells(path, [ROW, ROW])
    with pytest.raises(DocumentError, match="dwell 3 is also in line 2"):
        read_packed_dwells(path)


def test_columns_may_come_in_any_order_with_others_among_them():
    text = "\n".join(
        ",".join([*reversed(line.split(",")), extra])
        for line, extra in zip(format_dwells([ROW]).splitlines(), ["operator", "name"], strict=True)
    )
    assert format_dwells(parse_dwells(text, "x")) == format_dwells([ROW])


def test_optional_columns_may_be_missing_or_nan():
    optional = ("board", "chamber", "case", "paper", "accelerometer", "fit", "flag")
    needed = [i for i, c in enumerate(COLUMNS) if not c.startswith(optional)]
    text = "\n".join(
        ",".join(line.split(",")[i] for i in needed) for line in format_dwells([ROW]).splitlines()
    )
    (row,) = parse_dwells(text, "x")
    assert all(map(math.isnan, (row.board_c[2], *row.paper_bias_dph, *row.paper_sigma_dph)))
    assert math.isnan(row.fit_p_value)
    assert row.flags == ()
    (row,) = parse_dwells(format_dwells([ROW]).replace(",,,", ",nan,NaN,"), "x")
    assert math.isnan(row.chamber_c)


def test_a_dwell_with_flags_may_be_without_result():
    nothing = (math.nan,) * 3
    failed = replace(ROW, bias_dph=nothing, sigma_dph=nothing, gyro_c=nothing, flags=("gap of 6 s, at 12 s",))
    (row,) = parse_dwells(format_dwells([failed]), "x")
    assert math.isnan(row.bias_dph[0])
    assert row.flags == ("gap of 6 s, at 12 s",)
    with pytest.raises(DocumentError, match="x:2: column bias_x_dph"):
        parse_dwells(format_dwells([replace(failed, flags=())]), "x")


def test_rows_by_the_papers_method_are_those_that_it_applies_to():
    both = replace(ROW, paper_bias_dph=(0.01, 0.02, 0.03), paper_sigma_dph=(0.003,) * 3)
    (row,) = paper_rows([ROW, replace(both, common_sigma_dph=(0.001,) * 3)])
    assert (row.bias_dph, row.sigma_dph) == ((0.01, 0.02, 0.03), (0.003,) * 3)
    same = replace(row, bias_dph=ROW.bias_dph, sigma_dph=ROW.sigma_dph)
    assert repr(same) == repr(both)  # NaN does not equal itself


@pytest.mark.skipif(not CASES.is_dir(), reason="needs the shared cases beside the checkout")
def test_tables_of_another_bench_are_read():
    for path in sorted(CASES.glob("*/dwells.csv"))[:5]:
        rows = read_dwells(path)
        assert len(rows) == len(path.read_text(encoding="utf-8").splitlines()) - 1
        assert all(math.isfinite(value) for row in rows for value in row.bias_dph)
        assert paper_rows(rows) == []


def test_a_mark_in_front_of_the_file_is_no_matter(tmp_path):
    path = tmp_path / "dwells.csv"
    path.write_text("\ufeff" + format_dwells([ROW]), encoding="utf-8")
    assert read_dwells(path)[0].unit == "U7"


@pytest.mark.parametrize(
    ("column", "cell", "message"),
    [
        ("bias_y_dph", "", "x:2: column bias_y_dph: expected a number; found ''"),
        ("bias_y_dph", "nan", "x:2: column bias_y_dph: expected a number; found 'nan'"),
        ("gyro_z_c", "inf", "x:2: column gyro_z_c: expected a number; found 'inf'"),
        ("board_z_c", "hot", "x:2: column board_z_c: expected a number; found 'hot'"),
        ("dwell", "1.5", "x:2: column dwell: expected a whole number; found '1.5'"),
        ("position", "Z_UP", "x:2: column position: expected one of z_up, z_down, .*; found 'Z_UP'"),
        ("position", "Z-UP", "found 'Z-UP' .did you mean 'z_up'"),
        ("bias_y_dph", '"0,5"', "expected a number; found '0,5'. A number has a decimal point, not a comma"),
        ("sigma_x_dph", "0", "x:2: column sigma_x_dph: an uncertainty must be above zero"),
        ("paper_sigma_y_dph", "-1", "x:2: column paper_sigma_y_dph: an uncertainty must be above zero"),
        ("sigma_x_dph", "1e-200", "x:2: column sigma_x_dph: an uncertainty must be above zero; found 1e-200"),
        ("common_sigma_z_dph", "-5", "a part of an uncertainty can't be negative; found -5"),
        ("bias_y_dph", "-1e200", "x:2: column bias_y_dph: -1e\\+200 is beyond 1e\\+30"),
        ("board_z_c", "1e999", "x:2: column board_z_c: inf is beyond 1e\\+30"),
        ("gyro_z_c", "-274", "x:2: column gyro_z_c: -274 degC is not a gyro temperature; allowed: -273.15"),
        ("gyro_x_c", "1001", "x:2: column gyro_x_c: 1001 degC is not a gyro temperature"),
        ("fit_p_value", "good", "x:2: column fit_p_value: expected a number; found 'good'"),
        ("end_s", "0", "x:2: column end_s: the dwell ends at 0 s, before it starts"),
    ],
)
def test_says_which_cell_is_wrong(column, cell, message):
    cells = format_dwells([ROW]).splitlines()[1].split(",")
    cells[COLUMNS.index(column)] = cell
    with pytest.raises(DocumentError, match=message):
        parse_dwells(",".join(COLUMNS) + "\n" + ",".join(cells), "x")


def test_lists_every_mistake_at_once_and_those_alike_in_a_column_once():
    text = format_dwells([replace(ROW, dwell=dwell) for dwell in range(40)]).replace("0.0019", "?")
    head, row, *rest = text.splitlines()
    with pytest.raises(DocumentError) as error:
        parse_dwells("\n".join([head, row.replace("y_up", "Z+"), *rest]), "x")
    assert str(error.value).splitlines() == [
        "x:2: column sigma_y_dph: expected a number; found '?' (and in 39 more lines)",
        "x:2: column position: expected one of z_up, z_down, y_up, y_down, x_up, x_down; found 'Z+'",
    ]


def test_refuses_a_dwell_number_given_twice():
    with pytest.raises(DocumentError, match="x:3: column dwell: dwell 3 is also in line 2"):
        parse_dwells(format_dwells([ROW, ROW]), "x")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "x:1: the file is empty. It needs a header with the columns unit, run"),
        ("unit;run;dwell\n1;1;1\n", "x:1: the separator seems to be ';'. Write the table with commas"),
        ("unit\trun\n1\t1\n", "x:1: the separator seems to be a tab. Write the table with commas"),
        (
            ",".join(each for each in COLUMNS if each != "bias_x_dph") + "\n",
            "x:1: the header lacks the column bias_x_dph; it has unit",
        ),
        ("unit,run\n", "x:1: the header lacks the columns dwell, cycle"),
        (",".join((*COLUMNS, "unit")) + "\n", "x:1: the header gives unit more than once"),
        (",".join(COLUMNS) + "\n1,2\n", f"x:2: 2 cells where the header has {len(COLUMNS)}"),
        (",".join(COLUMNS) + '\n"open', "x:2: not valid CSV"),
    ],
)
def test_refuses_a_table_of_another_shape(text, message):
    with pytest.raises(DocumentError, match=message):
        parse_dwells(text, "x")


def test_names_a_file_that_cannot_be_read_or_written(tmp_path):
    with pytest.raises(DocumentError, match=r"none\.csv: can't be read"):
        read_dwells(tmp_path / "none.csv")
    with pytest.raises(RunFolderError, match="can't be written"):
        write_dwells(tmp_path / "no folder" / "dwells.csv", [])
    (tmp_path / "latin.csv").write_bytes(b"\xb0C")
    with pytest.raises(DocumentError, match="is not UTF-8 text"):
        read_dwells(tmp_path / "latin.csv")


@pytest.mark.parametrize("name", ["=1+1", "@SUM(A1)", "+1", "-A1"])
@pytest.mark.parametrize("column", ["unit", "run"])
def test_a_name_that_a_spreadsheet_takes_for_a_formula_is_refused(column, name):
    text = format_dwells([replace(ROW, **{column: name})])
    with pytest.raises(DocumentError, match=f"table:2: column {column}: a name can't begin with"):
        parse_dwells(text, "table")
