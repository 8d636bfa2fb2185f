"""Station files that differ from the shipped one."""

import pytest

from gyrobench.bench.foundations.shipped import find_document


@pytest.fixture
def changed(tmp_path):
    """``changed((old, new), ...)``: path of a copy of the emulated station with texts replaced."""

    def copy(*pairs):
        text = find_document("stations", "emulated").read_text()
        for old, new in pairs:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "station.yaml"
        path.write_text(text)
        return path

    return copy
