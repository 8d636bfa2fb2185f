import numpy as np
import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.sensor_log import record_log
from gyrobench.bench.sensor_log.document import RecordFormat
from gyrobench.bench.sensor_log.record_log import RecordLog

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


def test_a_record_that_was_cut_off_is_left_out_and_told(tmp_path):
    log = RecordLog(written(tmp_path, [[1, 10]], b"\0\0\0\0\0"), LAYOUT)
    assert log.truncated
    assert [batch["rate"].tolist() for batch in log.batches(["rate"], [])] == [[10.0]]


def test_a_missing_field_is_told_with_those_that_exist(tmp_path):
    log = RecordLog(written(tmp_path, [[1, 10]]), LAYOUT)
    for name in ("speed", 3):
        with pytest.raises(DocumentError, match=f"there is no field '{name}'.*time, rate"):
            list(log.batches([name], []))


def test_an_empty_file_and_one_that_is_not_there_are_told(tmp_path):
    with pytest.raises(DocumentError, match="holds no record of 8 bytes"):
        RecordLog(written(tmp_path, []), LAYOUT)
    with pytest.raises(DocumentError, match="can't be read"):
        RecordLog(tmp_path / "none.bin", LAYOUT)
