"""A real bus at 10,000 frames/s: received through slcan and socketcand, logged and decoded."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import gyrobench.drivers.ins
from gyrobench.bench.engine.live_unit import Capture
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.documents import parse_document, validate
from gyrobench.bench.runs.can_log import CanLog, read_can_log
from gyrobench.drivers.frames import concatenate
from gyrobench.drivers.ins.can_bus import open_bus
from gyrobench.drivers.ins.can_ins import CanIns
from gyrobench.drivers.ins.dbc_codec import load_dbc
from gyrobench.drivers.ins.navigation_data import decode_navigation
from gyrobench.drivers.ins.signal_map import SignalMap
from tests.benchmarks.text_sender import IDENTIFIERS, payloads
from tests.drivers.ins.conftest import SIGNALS

RATE = 10_000
SECONDS = float(os.environ.get("REAL_BUS_SECONDS", "60"))
#: As stations poll the bus and as they evaluate an estimate of a dwell.
POLL_S, DECODE_S = 1.0, 10.0
KINDS = {
    "slcan, pseudo-terminal": ("pty", lambda address: ("slcan", address, {"sleep_after_open": 0.0})),
    "slcan, socket://": (
        "socket", lambda address: ("slcan", f"socket://127.0.0.1:{address}", {"sleep_after_open": 0.0}),
    ),
    "socketcand": (
        "socketcand", lambda address: ("socketcand", "can0", {"host": "127.0.0.1", "port": int(address)}),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", KINDS)
def test_ten_thousand_frames_per_second(name, tmp_path):
    kind, of_address = KINDS[name]
    sender = subprocess.Popen(
        [sys.executable, str(Path(__file__).with_name("text_sender.py")), kind, str(RATE), str(SECONDS)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    interface, channel, options = of_address(sender.stdout.readline().strip())
    database = load_dbc(Path(gyrobench.drivers.ins.__file__).with_name("gyrobench_ins.dbc"))
    signal_map = validate(parse_document(SIGNALS, Path("station.yaml")), SignalMap)
    clock, log = WallClock(), CanLog(tmp_path)
    bus = open_bus(interface, channel, clock, **options)
    driver, capture, epochs = CanIns(bus, signal_map, database, clock), Capture(1), 0

    def received(block):
        log.write(block)
        capture.add(block)

    driver.on_frames = received
    begin_s, begin_cpu_s, next_s = time.monotonic(), time.process_time(), DECODE_S
    expected = int(RATE * SECONDS)
    while driver.frames < expected and time.monotonic() - begin_s < 3.0 * SECONDS + 10.0:
        clock.sleep(POLL_S)
        driver.poll()
        driver.status().mode  # noqa: B018 - as at every tick
        if clock.now() >= next_s or driver.frames >= expected:
            next_s += DECODE_S
            decode_navigation(capture.frames(), signal_map, driver.codec)
            capture = Capture(1)
            epochs += 1
    log.cut()
    cpu_s, took_s = time.process_time() - begin_cpu_s, time.monotonic() - begin_s
    lost, largest = bus.lost, bus.max_queued_bytes
    sent, sent_s, sender_cpu_s = map(float, sender.stdout.readline().split())
    driver.close()
    sender.communicate("")
    logged = concatenate([part for _, part in read_can_log(tmp_path)])
    print(
        f"\n{name}: {sent:.0f} frames sent in {sent_s:.1f} s, {driver.frames} received, "
        f"{sent - driver.frames:.0f} missing, {lost} dropped at a full queue of at most "
        f"{largest / 1e3:.0f} kB; receiver {cpu_s:.2f} s of processor time in {took_s:.1f} s, "
        f"{cpu_s / took_s:.1%} of a core, {cpu_s / sent * 1e6:.2f} us a frame; sender {sender_cpu_s:.1f} s"
    )
    assert (lost, len(logged)) == (0, expected)
    assert np.array_equal(logged.data, payloads(0, expected))
    assert np.array_equal(logged.arbitration_id, np.resize(IDENTIFIERS, expected))
    assert cpu_s / took_s < 0.25
