"""Stations of the tests: behind real ports, and without any instrument that answers."""

from contextlib import contextmanager

from gyrobench.bench.foundations.shipped import find_document
from tests.drivers.emulators.forked import served


def changed_station(folder, changes):
    """The shipped station with its texts replaced, written to a folder."""
    text = find_document("stations", "emulated").read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    path = folder / "station.yaml"
    path.write_text(text)
    return path


@contextmanager
def served_station(folder, speed=1):
    """A station in real time, or ``speed`` times as fast, whose emulators another process serves."""
    server, urls = served("--world", "ideal", "--for-s", "1000", "--speed", speed)
    changes = {
        "clock: virtual": f"clock: wall\nspeed: {speed}",
        ", gravity_uncertainty_mps2: 1.0e-6": "",
        "poll_period_s: 1.0": "poll_period_s: 0.1",
        "instruments_period_s: 10.0": "instruments_period_s: 2.0",
        "emulator://table": urls["table"],
        "emulator://chamber": urls["chamber"],
        "interface: emulator": "interface: slcan",
        "channel: ins": f"channel: {urls['ins']}",
        "bitrate: 500000": "bitrate: 500000\n  options: {sleep_after_open: 0.1}",
    }
    try:
        yield changed_station(folder, changes)
    finally:
        server.close()


def absent_station(folder):
    """A station in real time of which no instrument is there."""
    return changed_station(
        folder,
        {
            "emulator://table": "/dev/no_table",
            "emulator://chamber": "/dev/no_chamber",
            "interface: emulator": "interface: socketcan",
            "channel: ins": "channel: no_can",
            "clock: virtual": "clock: wall",
        },
    )
