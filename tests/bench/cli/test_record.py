"""`gyrobench record` and `gyrobench replay`, on emulated benches in virtual time."""

import can
import pytest

from gyrobench.bench.foundations.shipped import find_document
from gyrobench.drivers.recording.recording_file import read_recording
from tests.bench.command_line import gyrobench, output_of


def record(tmp_path, *options):
    return gyrobench("record", "emulated", *options, cwd=tmp_path)


@pytest.mark.parametrize(
    ("instrument", "dialect", "asked"),
    [
        ("table", "acutrol3000", ["identify", "limits", "read", "identify"]),
        ("chamber", "watlow_f4", ["identify", "read", "limits_c", "set_point_c"]),
    ],
)
def test_an_instrument_is_asked_recorded_and_replayed(tmp_path, instrument, dialect, asked):
    result = record(tmp_path, "--instrument", instrument, "--out", "a.rec", "--note", "a quirk")
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.endswith("Recorded a.rec\n")
    recording = read_recording(tmp_path / "a.rec")
    header = recording.header
    assert (header.instrument, header.dialect, header.source) == (instrument, dialect, "emulator")
    assert header.note == "a quirk"
    assert header.identity
    assert [call.ask for call in header.calls] == asked
    assert all(call.gives for call in header.calls)
    assert {transfer.is_sent for transfer in recording.transfers} == {True, False}

    assert output_of("replay", "a.rec", cwd=tmp_path).count("same ") == len(asked)


def test_a_recording_shows_what_the_driver_makes_of_a_reply_now(tmp_path):
    record(tmp_path, "--instrument", "chamber", "--out", "a.rec")
    path = tmp_path / "a.rec"
    path.write_text(path.read_text().replace("(-60.0, 100.0)", "(-60.0, 120.0)"))
    replayed = gyrobench("replay", "a.rec", cwd=tmp_path)
    assert replayed.returncode == 1
    assert "CHANGED  limits_c: (-60.0, 100.0)\n         recorded: (-60.0, 120.0)" in replayed.stdout


def test_a_driver_that_gets_no_reply_is_recorded_too(tmp_path):
    faults = tmp_path / "faults.yaml"
    faults.write_text("faults:\n  - {fault: lost_reply, target: chamber, at_s: 0, replies: 5}\n")
    result = record(tmp_path, "--instrument", "chamber", "--out", "a.rec", "--faults", str(faults))
    assert result.returncode == 3
    assert result.stderr.startswith("gyrobench: chamber: ")
    recording = read_recording(tmp_path / "a.rec")
    assert recording.transfers
    assert all(transfer.is_sent for transfer in recording.transfers)


def test_the_ins_is_switched_on_listened_to_and_logged(tmp_path):
    result = record(tmp_path, "--instrument", "ins", "--out", "ins.log", "--for-s", "2")
    assert result.returncode == 0
    assert "serial number 1001" in result.stdout
    with can.LogReader(tmp_path / "ins.log") as reader:
        frames = list(reader)
    assert {0x001, 0x004, 0x006, 0x007, 0x010} <= {frame.arbitration_id for frame in frames}
    assert frames[-1].timestamp - frames[0].timestamp == pytest.approx(2.0, abs=0.2)


def test_the_lines_of_another_command_are_recorded_on_the_same_station(tmp_path):
    result = record(tmp_path, "--out", "lines", "--", "check", "--world", "ideal")
    assert result.returncode == 0
    assert ": ready for a run" in result.stdout
    assert result.stdout.endswith("Recorded lines/chamber-001.rec, lines/table-001.rec\n")
    table = read_recording(tmp_path / "lines/table-001.rec")
    assert table.transfers[0].data == b"*IDN?\r\n"
    assert table.header.dialect == "acutrol3000"


def test_the_exit_code_of_the_other_command_is_kept(tmp_path):
    result = record(tmp_path, "--out", "lines", "--", "check", "--procedure", "none_such")
    assert result.returncode == gyrobench("check", "--procedure", "none_such", cwd=tmp_path).returncode != 0


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--out", "a.rec"), "give --instrument"),
        (("--out", "a", "--proxy", "--", "check"), "omit --instrument"),
        (("--out", "ins.txt", "--instrument", "ins"), r"a CAN log is named \*.log"),
        (("--out", "there.rec", "--instrument", "table"), "there.rec: exists already"),
        (("--out", "a.rec", "--instrument", "ins", "--proxy"), "a proxy needs an INS on slcan"),
    ],
)
def test_what_can_not_be_done_is_refused_with_a_reason(tmp_path, options, reason):
    (tmp_path / "there.rec").write_text("")
    result = record(tmp_path, *options)
    assert result.returncode == 2
    assert reason.replace("\\", "") in result.stderr


def test_the_proxy_passes_on_and_records_until_its_time_is_over(tmp_path):
    link = tmp_path / "chamber"
    result = record(
        tmp_path,
        "--instrument",
        "chamber",
        "--out",
        "a.rec",
        "--proxy",
        "--port",
        str(link),
        "--for-s",
        "0.1",
    )
    assert result.returncode == 0
    assert f"The chamber is at {link}; Ctrl-C ends the recording." in result.stdout
    assert not link.is_symlink()
    header = read_recording(tmp_path / "a.rec").header
    assert (header.dialect, header.baudrate, header.parity) == ("watlow_f4", 9600, "N")


def test_a_station_can_stand_on_recordings(tmp_path):
    record(tmp_path, "--instrument", "chamber", "--out", "chamber.rec")
    text = find_document("stations", "emulated").read_text()
    text = text.replace("clock: virtual", "clock: wall\nspeed: 20")
    text = text.replace("emulator://chamber", f"replay://{tmp_path}/chamber.rec")
    (tmp_path / "replayed.yaml").write_text(text)
    output_of("record", "replayed.yaml", "--instrument", "chamber", "--out", "again.rec", cwd=tmp_path)
    first, again = (read_recording(tmp_path / name) for name in ("chamber.rec", "again.rec"))
    for is_sent in (True, False):
        went = [b"".join(t.data for t in each.transfers if t.is_sent is is_sent) for each in (first, again)]
        assert went[0] == went[1]
    assert again.header.calls == first.header.calls
