import numpy as np
import pytest

from gyrobench.bench.exchange import log_files as record_log
from gyrobench.bench.exchange import log_files as text_log
from gyrobench.bench.exchange.import_map import RecordFormat, TextFormat
from gyrobench.bench.exchange.log_files import RecordLog, TextLog
from gyrobench.bench.foundations.errors import DocumentError


def read(path, content, numbers=("a", "b"), texts=(), **layout):
    path = path / "log.txt"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    log = TextLog(path, TextFormat(**layout))
    batches = list(log.batches(numbers, texts))
    return log, {name: np.concatenate([batch[name] for batch in batches]) for name in (*numbers, *texts)}


@pytest.mark.parametrize(
    ("content", "layout"),
    [
        ("a,b\n1,2\n3,4\n", {}),
        ("a;b\n1;2\n3;4", {}),
        ("a\tb\r\n1\t2\r\n3\t4\r\n", {}),
        ("  a  b\n 1   2\n\t3 \t 4  \n", {}),
        ('"a","b"\n1,2\n3,4\n', {}),
        ("\ufeffa,b\n1,2\n\n3,4\n\n", {}),
        ("a;b\n1,0;2,0\n3,0;4,0\n", {"decimal": ","}),
        ("logger 7, firmware 2\n\n# raw\na,b\n1,2\n# restarted\n3,4\n", {"skip_lines": 2, "comment": "#"}),
    ],
)  # fmt: skip
def test_the_usual_ways_to_write_a_table_are_read(tmp_path, content, layout):
    _, columns = read(tmp_path, content, **layout)
    assert columns["a"].tolist() == [1.0, 3.0]
    assert columns["b"].tolist() == [2.0, 4.0]


def test_without_a_header_columns_have_numbers(tmp_path):
    _, columns = read(tmp_path, "1 2\n3 4\n", numbers=(2,), header=False)
    assert columns[2].tolist() == [2.0, 4.0]


def test_what_was_not_measured_is_nan_and_texts_stay_texts(tmp_path):
    _, columns = read(tmp_path, "a,b,s\n1,nan,ok\n,None,\n3,inf,bad\n", texts=("s",))
    np.testing.assert_array_equal(columns["a"], [1.0, np.nan, 3.0])
    np.testing.assert_array_equal(columns["b"], [np.nan, np.nan, np.inf])
    assert columns["s"].tolist() == ["ok", "", "bad"]


def test_a_column_that_is_not_used_may_hold_anything(tmp_path):
    _, columns = read(tmp_path, b"a,note,b\n1,20 \xb0C,2\n", numbers=("a", "b"))
    assert columns["b"].tolist() == [2.0]


def test_a_large_log_comes_in_batches(tmp_path, monkeypatch):
    monkeypatch.setattr(text_log, "_BLOCK_BYTES", 1000)
    path = tmp_path / "log.csv"
    path.write_text("a,b\n# note\n" + "".join(f"{index},{-index}\n" for index in range(5000)))
    batches = list(TextLog(path, TextFormat(comment="#")).batches(["a"], []))
    assert len(batches) > 10
    np.testing.assert_array_equal(np.concatenate([batch["a"] for batch in batches]), np.arange(5000.0))


def test_a_line_of_units_below_the_header_is_shown_with_what_reads_it(tmp_path):
    content = "a,b\ns,deg/s\n1,2\n3,4\n"
    with pytest.raises(DocumentError, match=r"found 'deg/s'\nIf that line .*header: false, skip_lines: 2}"):
        read(tmp_path, content)
    assert read(tmp_path, content, numbers=(1, 2), header=False, skip_lines=2)[1][1].tolist() == [1.0, 3.0]
    with pytest.raises(DocumentError) as error:
        read(tmp_path, "a,b\n1,2\na,b\n3,4\n")
    assert "skip_lines" not in str(error.value)


@pytest.mark.parametrize(
    ("decimal", "other", "content"), [(",", ".", "a;b\n1.5;2\n"), (".", ",", "a;b\n1,5;2\n")]
)
def test_the_other_decimal_point_is_shown_with_its_place(tmp_path, decimal, other, content):
    with pytest.raises(DocumentError, match=rf"log\.txt:2: column a: .* \(is 'text.decimal' '\{other}'\?\)"):
        read(tmp_path, content, decimal=decimal)


def test_a_missing_column_is_shown_with_those_that_exist(tmp_path):
    with pytest.raises(DocumentError, match=r"log\.txt: there is no column 'c'. It has 2: 'a', 'b'"):
        read(tmp_path, "a,b\n1,2\n", numbers=("c",))
    with pytest.raises(
        DocumentError, match=r"no column 'gx \[deg/s\]' \(did you mean 'gx \[deg/h\]'\?\)\. It has 2"
    ):
        read(tmp_path, "gx [deg/h];b, raw\n1;2\n", numbers=("gx [deg/s]",))
    with pytest.raises(DocumentError, match=r"there is no column '3'\. It has 2"):
        read(tmp_path, "a,b\n1,2\n", numbers=(3,))


def test_a_name_given_twice_is_reported(tmp_path):
    with pytest.raises(DocumentError, match="the header gives 'a' twice; map it by its number"):
        read(tmp_path, "a,a\n1,2\n", numbers=("a",))


def test_a_column_taken_for_a_number_and_for_text_is_reported(tmp_path):
    with pytest.raises(DocumentError, match="uses column b as a number and as a status or position"):
        read(tmp_path, "a,b\n1,2\n", texts=(2,))


@pytest.mark.parametrize("content", ["", "a,b\n", "\n\n"])
def test_a_file_without_samples_is_reported(tmp_path, content):
    with pytest.raises(DocumentError, match="holds no sample"):
        read(tmp_path, content)


def test_binary_records_are_not_taken_for_text(tmp_path):
    with pytest.raises(DocumentError, match=r"log\.txt: is not text\. For binary records give 'records'"):
        read(tmp_path, np.arange(10.0).tobytes())


def test_a_file_that_is_not_there_is_reported(tmp_path):
    with pytest.raises(DocumentError, match=r"none\.csv: can't be read: No such file"):
        TextLog(tmp_path / "none.csv", TextFormat())


def test_cells_that_are_no_numbers_are_shown_with_line_and_column(tmp_path):
    content = "# x\na,b\n1,2\n3,4x\n# y\nfive,6\n1_0,2\n"
    with pytest.raises(DocumentError) as caught:
        read(tmp_path, content, comment="#")
    path = tmp_path / "log.txt"
    assert str(caught.value).splitlines() == [
        f"{path}:4: column b: expected a number; found '4x'",
        f"{path}:6: column a: expected a number; found 'five' (and in 1 more lines)",
    ]


def test_a_column_that_is_read_for_several_quantities_counts_its_wrong_lines_once(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("a,b\n1,x\n1,y\n1,z\n")
    with pytest.raises(DocumentError, match=r"found 'x' \(and in 2 more lines\)"):
        list(TextLog(path, TextFormat()).batches(["a", "b", "b", "b"], []))


def test_lines_with_another_number_of_cells_are_reported(tmp_path):
    with pytest.raises(DocumentError, match=r"log\.txt:3: 1 cells instead of 2"):
        read(tmp_path, "a,b\n1,2\n3\n5,6\n")


def test_a_last_line_that_was_cut_off_is_left_out_and_reported(tmp_path):
    log, columns = read(tmp_path, "a,b\n1,2\n3,4\n5")
    assert log.truncated
    assert columns["a"].tolist() == [1.0, 3.0]


LAYOUT = RecordFormat(fields=["time", "rate"], type=">i4", header_bytes=3)


def written(path, records, tail=b""):
    path = path / "log.bin"
    path.write_bytes(b"abc" + np.array(records, ">i4").tobytes() + tail)
    return path


def test_records_are_read_behind_the_header_batch_by_batch(tmp_path, monkeypatch):
    monkeypatch.setattr(record_log, "_BATCH_RECORDS", 2)
    log = RecordLog(written(tmp_path, [[1, 10], [2, 20], [3, 30]]), LAYOUT)
    batches = list(log.batches(["rate", 1], ["time"]))
    assert [batch["rate"].tolist() for batch in batches] == [[10.0, 20.0], [30.0]]
    assert batches[1][1].tolist() == [3.0]
    assert batches[0]["time"].tolist() == ["1", "2"]
    assert not log.truncated


def test_a_record_that_was_cut_off_is_left_out_and_reported(tmp_path):
    log = RecordLog(written(tmp_path, [[1, 10]], b"\0\0\0\0\0"), LAYOUT)
    assert log.truncated
    assert [batch["rate"].tolist() for batch in log.batches(["rate"], [])] == [[10.0]]


def test_a_missing_field_is_shown_with_those_that_exist(tmp_path):
    log = RecordLog(written(tmp_path, [[1, 10]]), LAYOUT)
    for name in ("speed", 3):
        with pytest.raises(DocumentError, match=f"there is no field '{name}'.*time, rate"):
            list(log.batches([name], []))


def test_an_empty_file_and_one_that_is_not_there_are_reported(tmp_path):
    with pytest.raises(DocumentError, match="holds no record of 8 bytes"):
        RecordLog(written(tmp_path, []), LAYOUT)
    with pytest.raises(DocumentError, match="can't be read"):
        RecordLog(tmp_path / "none.bin", LAYOUT)
