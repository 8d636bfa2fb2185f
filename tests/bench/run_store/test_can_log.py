import can
import pytest

from bench.errors import RunFolderError
from bench.run_store.can_log import CanLog, read_can_log


def frames(start, count):
    return [
        can.Message(
            timestamp=946684800.0 + 0.1 * k,
            arbitration_id=k % 8,
            data=k.to_bytes(8, "little"),
            is_extended_id=False,
        )
        for k in range(start, start + count)
    ]


def test_frames_come_back_in_order_across_parts(tmp_path):
    log = CanLog(tmp_path)
    log.write(frames(0, 500))
    log.cut()
    log.write(frames(500, 300))
    log.cut()
    parts = [part for _, part in read_can_log(tmp_path)]
    assert [len(part) for part in parts] == [500, 300]
    for written, read in zip(frames(0, 800), [message for part in parts for message in part], strict=True):
        assert (read.arbitration_id, bytes(read.data)) == (written.arbitration_id, bytes(written.data))
        assert read.timestamp == pytest.approx(written.timestamp, abs=1e-6)


def test_python_cans_own_reader_opens_every_part(tmp_path):
    log = CanLog(tmp_path)
    log.write(frames(0, 50))
    log.cut()
    with can.LogReader(tmp_path / "part-00001.blf") as reader:
        assert sum(1 for _ in reader) == 50


def test_what_was_cut_survives_a_part_that_was_never_ended(tmp_path):
    log = CanLog(tmp_path)
    log.write(frames(0, 100))
    log.cut()
    log.write(frames(100, 5000))
    whole, rest = (part for _, part in read_can_log(tmp_path))
    assert len(whole) == 100
    assert len(rest) <= 5000
    log.cut()


def test_a_new_log_goes_on_with_the_numbering(tmp_path):
    for _ in range(2):
        log = CanLog(tmp_path)
        log.write(frames(0, 1))
        log.cut()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["part-00001.blf", "part-00002.blf"]


def test_a_damaged_part_before_the_last_is_an_error(tmp_path):
    for name in ("part-00001.blf", "part-00002.blf"):
        (tmp_path / name).write_bytes(b"not a BLF file")
    with pytest.raises(RunFolderError, match="part-00001"):
        list(read_can_log(tmp_path))


def test_an_absent_log_is_an_error(tmp_path):
    with pytest.raises(RunFolderError, match="no CAN log"):
        list(read_can_log(tmp_path))
