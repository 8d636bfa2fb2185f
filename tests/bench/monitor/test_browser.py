"""The page in a real browser, without a screen."""

import os
import re
import shutil
import struct
import subprocess
from dataclasses import replace
from http import HTTPStatus

import numpy as np
import pytest
from PIL import Image

from gyrobench.bench.monitor.server import refusal
from gyrobench.bench.monitor.snapshot import RunState
from gyrobench.bench.monitor.website import Website
from tests.bench.monitor.sample_snapshots import made_up_snapshot, waiting_snapshot
from tests.bench.monitor.served_run import now, run_under_way, served, write_snapshot

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--enable-logging=stderr",
)  # fmt: skip


@pytest.fixture
def chromium(tmp_path):
    if CHROMIUM is None:
        if os.environ.get("CI"):
            pytest.fail("Chromium is not installed, and where CI is set it has to be")
        pytest.skip("Chromium is not installed")

    def run(url, *options):
        """Open a page; what it printed, and what the page complained of."""
        command = [CHROMIUM, *OPTIONS, f"--user-data-dir={tmp_path / 'profile'}", *options, url]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
        return ended.stdout, [line for line in ended.stderr.splitlines() if ":CONSOLE" in line]

    return run


def colours(pixels):
    """Colours of some of the pixels: one or two where nothing is drawn."""
    return {tuple(colour) for colour in pixels[::7, ::7].reshape(-1, pixels.shape[2])}


class Changing:
    """A site on which something is done before the page asks for freshness the first time."""

    def __init__(self, run, change):
        self._site, self._change = Website(run, now), change
        self.asked = []

    def answer(self, target):
        if target == "/fragment" and target not in self.asked:
            self._change()
        self.asked.append(target)
        return self._site.answer(target)


def test_the_page_takes_in_what_is_new_by_itself_and_complains_of_nothing(chromium, tmp_path):
    with run_under_way(tmp_path / "mine") as run:
        site = Changing(run, lambda: write_snapshot(run, waiting_snapshot()))
        with served(site.answer) as server:
            page, complaints = chromium(server.url, "--dump-dom", "--virtual-time-budget=5000")
    assert "waiting for the operator" in page
    assert "ALARM rate table" in page
    assert "<title>▲ ALARM: mine</title>" in page
    assert re.search('<section id="dwell"[^>]* hidden', page)
    assert complaints == []
    assert site.asked.count("/") == 1
    assert set(site.asked) <= {"/", "/fragment", "/favicon.ico"}


def test_the_page_says_when_the_monitor_is_over(chromium, tmp_path):
    with run_under_way(tmp_path / "mine") as run:
        site = Website(run, now)

        def answer(target):
            return site.answer(target) if target == "/" else refusal(HTTPStatus.BAD_GATEWAY, "no answer")

        with served(answer) as server:
            page, _ = chromium(server.url, "--dump-dom", "--virtual-time-budget=12000")
    assert "No answer from the monitor for" in page
    assert "<title>▲ no answer: mine</title>" in page.replace("running, 6:00 h left: ", "")


def test_the_page_of_a_run_becomes_a_list_and_back_where_the_folder_does(chromium, tmp_path):
    site = Changing(tmp_path, lambda: write_snapshot(tmp_path, state=RunState.FINISHED))
    with served(site.answer) as server:
        page, _ = chromium(server.url, "--dump-dom", "--virtual-time-budget=5000")
    assert "finished" in page
    assert site.asked.count("/") == 2


def test_the_page_is_drawn_where_no_script_runs(chromium, tmp_path):
    shot = tmp_path / "shot.png"
    with run_under_way(tmp_path / "mine") as run:
        site, asked = Website(run, now), []

        def answer(target):
            asked.append(target)
            whole = site.answer(target)
            return replace(whole, policy=whole.policy.replace("script-src", "manifest-src"))

        with served(answer) as server:
            _, complaints = chromium(server.url, "--virtual-time-budget=5000", f"--screenshot={shot}")
    assert "script" in "".join(complaints)
    assert "/fragment" not in asked
    assert len(colours(np.asarray(Image.open(shot)))) > 10


@pytest.mark.parametrize(
    ("snapshot", "width", "height"),
    [
        (made_up_snapshot(), 360, 740),
        (made_up_snapshot(), 1280, 900),
        pytest.param(waiting_snapshot(), 360, 740, marks=pytest.mark.long),
        pytest.param(replace(made_up_snapshot(), state=RunState.FINISHED), 360, 740, marks=pytest.mark.long),
    ],
    ids=["running on a phone", "running on a desk", "waiting on a phone", "finished on a phone"],
)
def test_the_page_fits_phone_and_desk(chromium, tmp_path, snapshot, width, height):
    shot = tmp_path / "shot.png"
    with run_under_way(tmp_path / "mine", snapshot) as run, served(run) as server:
        chromium(server.url, f"--window-size={width},{6 * height}", f"--screenshot={shot}")
    assert struct.unpack(">II", shot.read_bytes()[16:24]) == (width, 6 * height)
    pixels = np.asarray(Image.open(shot))
    margin = pixels[:, -6:]
    assert (margin == margin[0, 0]).all(), "something reaches over the right margin"
    assert len(colours(pixels[:height])) > 10
