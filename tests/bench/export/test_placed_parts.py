import shutil

import can
import pytest

from gyrobench.bench.export.placed_parts import PlacedLog
from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.provenance import started_utc


@pytest.fixture
def copied(two_dwells, tmp_path):
    shutil.copytree(two_dwells.path, tmp_path / "run")
    return RunFolder(tmp_path / "run")


def rewrite(folder, change):
    """Write the parts of a log anew with other times."""
    parts = list(read_can_log(folder.can))
    for number, messages in parts:
        with can.BLFWriter(folder.can / f"part-{number:05d}.blf") as writer:
            for message in messages:
                message.timestamp = change(number, message.timestamp)
                writer.on_message_received(message)


def test_parts_with_calendar_times_stay_as_they_are(two_dwells):
    log = PlacedLog(two_dwells)
    placed = {part.number: [m.timestamp for m in part.messages] for part in log}
    logged = {number: [m.timestamp for m in messages] for number, messages in read_can_log(two_dwells.can)}
    assert placed == {number: times for number, times in logged.items() if times}
    assert log.estimated == []


def test_a_dwell_tells_the_time_where_the_adapter_has_a_clock_of_its_own(two_dwells, copied):
    began_s = started_utc(two_dwells).timestamp()
    rewrite(copied, lambda number, time_s: time_s - began_s + 100.0 * number)
    log, good = PlacedLog(copied), list(PlacedLog(two_dwells))
    placed = list(log)
    assert sum(len(part.messages) for part in placed) == sum(len(part.messages) for part in good)
    for part, right in zip(placed, good, strict=True):
        exact = part.number in log.finished
        assert exact != (part.number in log.estimated)
        off_s = part.messages[0].timestamp - right.messages[0].timestamp
        assert abs(off_s) < (1.1 if exact else 30.0)  # a tick; the way from dwell to dwell
        assert part.messages[-1].timestamp - part.messages[0].timestamp == pytest.approx(
            right.messages[-1].timestamp - right.messages[0].timestamp, abs=1e-5
        )


def test_a_part_that_was_never_closed_follows_the_one_before(two_dwells, copied):
    lines = copied.journal.read_text().splitlines(keepends=True)
    copied.journal.write_text("".join(line for line in lines if "dwell_finished" not in line))
    last = max(copied.can.glob("*.blf"))
    content = bytearray(last.read_bytes())
    content[40:72] = bytes(32)  # begin and end, which are written when a part is closed
    last.write_bytes(content)
    log = PlacedLog(copied)
    *_, before, part = log
    assert log.estimated == [part.number]
    assert part.messages[0].timestamp == before.messages[-1].timestamp
    *_, right = PlacedLog(two_dwells)
    assert abs(part.messages[0].timestamp - right.messages[0].timestamp) < 30.0
