import getpass
import platform
from datetime import UTC, datetime

from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.provenance import read_provenance, write_provenance


def written(tmp_path):
    folder = RunFolder(tmp_path)
    for path in (folder.procedure, folder.station):
        path.write_text("a: 1\n")
    write_provenance(folder, datetime(2026, 1, 1, tzinfo=UTC), {}, {})
    return read_provenance(folder)


def test_who_started_it_and_where_is_told(tmp_path):
    own = written(tmp_path)
    assert own["operator"] == getpass.getuser()
    assert own["host"] == platform.node()
    offset = datetime(2026, 1, 1, tzinfo=UTC).astimezone().utcoffset()
    assert own["utc_offset_s"] == offset.total_seconds()


def test_a_user_without_a_name_is_no_fault(tmp_path, monkeypatch):
    def nobody():
        raise OSError("no such user")

    monkeypatch.setattr(getpass, "getuser", nobody)
    assert written(tmp_path)["operator"] == "unknown"
