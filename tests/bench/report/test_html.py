"""The report: complete, self-contained, and there also for runs that came to nothing."""

from __future__ import annotations

import base64
from collections.abc import Callable
from dataclasses import dataclass, field
from html.parser import HTMLParser

import pytest

from bench.bias.bins import bin_biases, write_bins
from bench.bias.dwell_table import DwellRow, write_dwells
from bench.report.html import write_report
from bench.run_store.folder import RunFolder


@dataclass
class Page(HTMLParser):
    """Text, attributes that load something, and open tags of a page."""

    words: list[str] = field(default_factory=list)
    loads: list[str] = field(default_factory=list)
    tags: list[str] = field(default_factory=list)
    open_tags: list[str] = field(default_factory=list)
    in_style: bool = False
    style: str = ""

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in ("meta", "img", "br"):
            self.open_tags.append(tag)
        self.loads += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open_tags.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open_tags[-1:] == ["style"]:
            self.style += data
        else:
            self.words += data.split()

    @property
    def text(self) -> str:
        return " ".join(self.words)


def page_of(folder: RunFolder) -> Page:
    page = Page()
    page.feed(write_report(folder).read_text(encoding="utf-8"))
    page.close()
    assert page.open_tags == []
    return page


@pytest.fixture(scope="module")
def page(run_folder: RunFolder) -> Page:
    return page_of(run_folder)


def test_report_needs_nothing_from_outside(page: Page, run_folder: RunFolder) -> None:
    assert len(page.loads) == 5
    for load in page.loads:
        assert load.startswith("data:image/png;base64,")
    embedded = {base64.b64decode(load.partition(",")[2]) for load in page.loads}
    assert embedded == {path.read_bytes() for path in run_folder.figures.glob("*.png")}
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    assert "url(" not in page.style
    assert "@import" not in page.style


def test_head_says_what_was_run_and_how_it_ended(page: Page) -> None:
    assert page.text.count("Gyro bias of unit 1001") == 2
    for words in (
        "The run finished.",
        "procedure six_position_fig7",
        "station emulated",
        "started (UTC) 2000-01-01 00:00:00",
        "duration 1:01 h",
        "72 measured, 1 of them flagged",
        "seed 0, world gyro_a",
    ):
        assert words in page.text


def test_instruments_versions_and_assumptions_are_there(page: Page) -> None:
    for words in (
        "rate table Acutrol3000 rev 2.1",
        "INS made-up INS, serial number 1001",
        "heading: 0.0001 deg a bit",
        "gyrobench 0.1.0",
        "numpy 2.1.0",
        "ab" * 32,
        "ramp rates are <chosen> here",
    ):
        assert words in page.text


def test_findings_are_told_in_words(page: Page) -> None:
    assert page.text.count("The bias differs between positions in") == 3
    assert "X-Down above Z-Up by 0.01" in page.text


def test_tables_hold_biases_counts_and_empty_bins(page: Page) -> None:
    assert "-20 to 5 empty in all positions" in page.text
    assert "-25 to -20 -6.8 ± 0.6 (2) -5.0 ± 0.6 (2)" in page.text
    assert page.text.count("Positions compared.") == 3
    assert "<1e-09" in page.text


def test_single_position_without_a_dwell_in_a_bin_is_empty(
    empty_folder: RunFolder, dwells: list[DwellRow]
) -> None:
    two = [row for row in dwells if row.position in ("y_up", "z_up")]
    write_dwells(empty_folder.dwells, [row for row in two if row.position == "z_up" or row.chamber_c < 60.0])
    text = page_of(empty_folder).text
    assert text.count("empty") - text.count("empty in all positions") == 3


def test_flagged_dwell_is_marked_with_its_reason_as_text(page: Page) -> None:
    assert "flagged: the INS left navigation during the dwell; chamber <door> open" in page.text
    assert "door" not in page.tags


def test_durations_and_safe_state_are_there(page: Page) -> None:
    assert "chamber 1 0:40:00 0:49:10 +0:09:10 (+22.9 %)" in page.text
    assert "ask operator 1 0:01:00 0:00:05" in page.text
    assert "all 5 0:53:00 1:01:27" in page.text
    assert "rate table stopped chamber switched off" in page.text
    assert "not reached in full" not in page.text


def test_equal_runs_give_equal_reports(page: Page, run_folder: RunFolder) -> None:
    first = run_folder.report.read_bytes()
    assert write_report(run_folder).read_bytes() == first


def test_run_whose_positions_agree_says_so(empty_folder: RunFolder, equal_dwells: list[DwellRow]) -> None:
    write_dwells(empty_folder.dwells, equal_dwells)
    write_bins(empty_folder.bias_bins, bin_biases(equal_dwells))
    assert page_of(empty_folder).text.count("No difference between positions found") == 3


def test_failed_run_tells_reason_step_and_what_is_not_safe(
    empty_folder: RunFolder, journal_writer: Callable[..., None]
) -> None:
    journal_writer(empty_folder, ended="failed", reason="chamber: no <reply>", problem="table: no reply")
    text = page_of(empty_folder).text
    assert (
        "The run failed. chamber: no <reply> It was in step 6, turn 180 deg (cycle 1, 62 degC, z_up)." in text
    )
    assert "The safe state was not reached in full" in text
    assert "rate table stopped: failed: table: no reply" in text
    assert "No dwell was measured." in text
    assert "No dwell gave a bias" in text
    assert "dwells.csv is missing." in text


def test_run_that_was_killed_is_told_as_such(
    empty_folder: RunFolder, journal_writer: Callable[..., None]
) -> None:
    journal_writer(empty_folder, ended="")
    text = page_of(empty_folder).text
    assert "The run has not ended. It was killed or cut off" in text
    assert "The journal tells of no safe state." in text


def test_empty_folder_still_gives_a_report(empty_folder: RunFolder) -> None:
    page = page_of(empty_folder)
    assert "serial number not known" in page.text
    assert page.loads == []
    assert "The journal tells of no step that was finished." in page.text


def test_dwells_that_are_all_flagged_still_give_a_report(
    empty_folder: RunFolder, dwells: list[DwellRow]
) -> None:
    write_dwells(empty_folder.dwells, [row for row in dwells if row.flags])
    page = page_of(empty_folder)
    assert "1 measured, 1 of them flagged" in page.text
    assert len(page.loads) == 1
