"""The report: complete, self-contained, and there also for runs that came to nothing."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shutil
import weakref
from dataclasses import dataclass, field, replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from gyrobench.bench.bias.acceptance import judge
from gyrobench.bench.bias.bins import BIAS_BINS_TABLE, bin_biases
from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.bias.verdicts import Acceptance, AcceptanceLimits, write_acceptance
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.report.bias_sections import acceptance_section, comparison_section
from gyrobench.bench.report.closure_page import write_closure_page
from gyrobench.bench.report.figures.bias import bias_figure
from gyrobench.bench.report.figures.style import new_figure
from gyrobench.bench.report.page import Section, SectionFigure, SectionTable, with_figure_files
from gyrobench.bench.report.run_content import read_run, with_joint_solution
from gyrobench.bench.report.run_report import render, write_report
from gyrobench.bench.report.verification_page import write_verification_page
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal
from gyrobench.bench.runs.tables.calibration_check_table import CALIBRATION_CHECK_TABLE
from tests.bench.report.made_up_closure import clean
from tests.bench.report.made_up_verification import confirmed
from tests.bench.report.test_calibration_check_section import ALIGNMENT, ROW


@dataclass
class Page(HTMLParser):
    """Text, attributes that load something, and open tags of a page."""

    words: list[str] = field(default_factory=list)
    loads: list[str] = field(default_factory=list)
    tags: list[str] = field(default_factory=list)
    links: list[str] = field(default_factory=list)
    anchors: list[str] = field(default_factory=list)
    open_tags: list[str] = field(default_factory=list)
    in_style: bool = False
    style: str = ""

    def __post_init__(self):
        super().__init__()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag not in ("meta", "img", "br"):
            self.open_tags.append(tag)
        named = [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data")]
        self.loads += [value for value in named if not value.startswith("#")]
        self.links += [value[1:] for value in named if value.startswith("#")]
        self.anchors += [value or "" for name, value in attrs if name == "id"]

    def handle_endtag(self, tag):
        assert self.open_tags.pop() == tag

    def handle_data(self, data):
        if self.open_tags[-1:] == ["style"]:
            self.style += data
        else:
            self.words += data.split()

    @property
    def text(self):
        return " ".join(self.words)


def page_with(html):
    page = Page()
    page.feed(html)
    page.close()
    assert page.open_tags == []
    return page


def page_of(folder):
    return page_with(write_report(folder).path.read_text(encoding="utf-8"))


def text_of(folder, prepared_by=""):
    """Text of the report without figures, which take most of the time."""
    content = with_joint_solution(read_run(folder), folder)
    return page_with("".join(render(content, [], prepared_by=prepared_by))).text


@pytest.fixture(scope="module")
def run_folder(run_folder, tmp_path_factory):
    """A copy that these tests write reports into."""
    return RunFolder(shutil.copytree(run_folder.path, tmp_path_factory.mktemp("run") / run_folder.path.name))


@pytest.fixture
def copy(run_folder, tmp_path):
    """A copy of the run to change."""
    folder = RunFolder(tmp_path / "run")
    shutil.copytree(run_folder.path, folder.path)
    return folder


@pytest.fixture(scope="module")
def page(run_folder):
    return page_of(run_folder)


def test_report_needs_nothing_from_outside(page, run_folder):
    assert len(page.loads) == 9
    for load in page.loads:
        assert load.startswith("data:image/png;base64,")
    embedded = {base64.b64decode(load.partition(",")[2]) for load in page.loads}
    assert embedded == {path.read_bytes() for path in run_folder.figures.glob("*.png")}
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    assert "url(" not in page.style
    assert "@import" not in page.style


def test_head_says_what_was_run_and_how_it_ended(page):
    assert page.text.count("Gyro bias of unit 1001") == 2
    for words in (
        "The run finished.",
        "procedure six_position_fig7",
        "bench emulated",
        "started 2000-01-01 00:00:00 UTC",
        "duration 1:01 h",
        "72 measured, 1 of them flagged",
        "seed 0, world gyro_a",
    ):
        assert words in page.text


def test_contents_lead_to_every_part(page):
    assert len(page.links) > 10
    assert page.links == page.anchors


def test_sign_off_has_blank_lines_but_for_the_name_given(empty_folder):
    text = text_of(empty_folder, "A. <Smith>")
    assert "name date signature prepared by A. <Smith> checked by released by Contents" in text


def test_report_can_go_elsewhere(empty_folder, equal_dwells):
    write_dwells(empty_folder.dwells, equal_dwells[:2])
    out = empty_folder.path / "elsewhere"
    assert write_report(empty_folder, out=out).path == out / "report.html"
    assert not empty_folder.report.exists()
    assert not empty_folder.figures.exists()


def test_operator_host_and_local_time_are_given(copy):
    own = json.loads(copy.provenance.read_text())
    own |= {"operator": "smith", "host": "bench-3", "utc_offset_s": 19_800.0}
    copy.provenance.write_text(json.dumps(own))
    text = text_of(copy)
    assert "started by smith on bench-3" in text
    assert "started 2000-01-01 00:00:00 UTC, 2000-01-01 05:30:00 local time (UTC+05:30)" in text
    assert "ended 2000-01-01 01:01:27 UTC, 2000-01-01 06:31:27 local time" in text


def test_a_verdict_stands_in_the_head_with_its_judgements_below(copy, dwells):
    limits = AcceptanceLimits(position_difference_dph=0.006, bias_dph=0.1)
    write_acceptance(copy.acceptance, judge(dwells, limits))
    text = text_of(copy)
    assert "Unit rejected. X gyro, Y gyro and Z gyro are beyond the limit of 0.006 deg/h" in text
    assert "Limits of the procedure: 0.006 deg/h between two positions at one plateau and" in text
    assert re.search(r"X gyro -25 to -20 X-Down above Z-Up fail \S+ ± \S+ \S+ \S+ 6\.0", text)


def test_acceptance_and_results_state_what_the_uncertainty_of_a_difference_is_of(dwells):
    acceptance = judge(dwells, AcceptanceLimits(position_difference_dph=0.006))
    drawn = {"position_differences": Path("position_differences.png")}
    [figure] = comparison_section(bin_biases(dwells), acceptance, drawn).figures
    assert "with its standard uncertainty (k = 1)" in figure.caption
    assert "a bin with dwells of several plateaus can be above them although the unit is" in figure.caption
    assert "those of bin means; the section Acceptance has those of plateaus corrected" in figure.caption
    section = acceptance_section(acceptance)
    how = " ".join(section.paragraphs)
    assert "standard uncertainties (k = 1)" in how
    assert "single dwell" not in how
    [table] = section.tables
    assert "with 95 % confidence limits" in table.caption
    assert "± standard uncertainty u (k = 1)" in table.caption
    limits = AcceptanceLimits(position_difference_dph=0.006, bias_dph=0.05)
    assert "A bias is that of the single dwell" in " ".join(
        acceptance_section(judge(dwells, limits)).paragraphs
    )
    assert "include that of the correction, which those of bin means in the section Results do not" in how


def test_without_limits_the_report_says_that_nothing_was_judged(copy):
    write_acceptance(copy.acceptance, Acceptance())
    assert "Unit not judged. The procedure has no acceptance limits." in text_of(copy)


def test_the_report_is_tied_to_its_data(page, run_folder):
    assert hashlib.sha256(run_folder.dwells.read_bytes()).hexdigest() in page.text
    assert "telemetry/*.parquet" in page.text


@pytest.mark.draws
def test_what_search_and_proof_found_is_taken_in_while_it_is_of_these_dwells(empty_folder, equal_dwells):
    folder = empty_folder
    write_dwells(folder.dwells, equal_dwells[:1])
    folder.closure.mkdir()
    write_closure_page(folder.closure, clean(), "the run", folder.dwells)
    folder.verify.mkdir()
    write_verification_page(folder.verify, confirmed(), folder.dwells)
    page = page_with("".join(render(read_run(folder), [])))
    assert "Search for effects Clean." in page.text
    assert "Verification of a compensation Confirmed." in page.text
    figures = {path.read_bytes() for path in folder.path.glob("*/figures/*.png")}
    assert figures == {base64.b64decode(load.partition(",")[2]) for load in page.loads}
    write_dwells(folder.dwells, equal_dwells[:2])
    changed = text_of(folder)
    assert "Search for effects Clean." not in changed
    assert "closure: left out because dwells.csv has changed since." in changed


def test_a_damaged_finding_is_named(empty_folder):
    for place in (empty_folder.closure, empty_folder.verify):
        place.mkdir()
    (empty_folder.closure / "findings.json").write_text("{}")
    (empty_folder.verify / "verification.html").write_text("")
    text = text_of(empty_folder)
    assert "findings.json: not a file of findings" in text
    assert "verify/findings.json is missing" in text


def test_instruments_versions_and_assumptions_are_there(page):
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


def test_results_are_stated_in_sentences(page):
    assert page.text.count("The bias differs between positions in") == 3
    assert "X-Down above Z-Up by 0.01" in page.text


def test_tables_hold_biases_counts_and_empty_bins(page):
    assert "-20 to 5 empty in all positions" in page.text
    assert re.search(r"-25 to -20 -6\.8 ± 0\.6 \(2\) \S+ ± 0\.8 -5\.0 ± 0\.6 \(2\) \S+ ± 0\.8", page.text)
    assert page.text.count("Comparison of positions;") == 3
    assert "<1e-9" in page.text


def test_both_estimates_of_a_dwell_and_its_fit_stand_in_one_row(page, dwells):
    first = dwells[0]
    pairs = zip(first.bias_dph, first.sigma_dph, first.paper_bias_dph, first.paper_sigma_dph, strict=True)
    cells = " ".join(
        f"{1e3 * bias:.1f} ± {1e3 * sigma:.1f} {1e3 * paper:.1f} ± {1e3 * paper_sigma:.1f}"
        for bias, sigma, paper, paper_sigma in pairs
    )
    assert f"{cells} {first.fit_p_value:.3f}" in page.text


def test_estimators_are_explained_and_compared(page):
    for words in (
        "Biases are those of the state-space estimator",
        "Results of the paper's method from the same data are in grey",
        "Comparison of the estimators The paper's method neglects",
        "over 71 dwells",
        "Goodness of fit",
        "Error model and noise explain the data.",
    ):
        assert words in page.text
    assert page.text.count("The paper's method disagrees") == 3


def test_comparison_names_the_estimators_that_find_a_difference(page):
    for verdict in ("both methods", "paper's method only"):
        assert verdict in page.text


def test_table_that_knows_no_estimators_gives_a_report_without_them(empty_folder, old_dwells):
    write_dwells(empty_folder.dwells, old_dwells)
    page = page_of(empty_folder)
    assert "The estimator of these biases is unknown" in page.text
    assert "paper" not in page.text
    assert len(page.loads) == 6


def test_run_that_the_papers_method_does_not_apply_to_says_so(empty_folder, dwells, old_dwells):
    tested = [
        replace(old, fit_ratio=row.fit_ratio, fit_p_value=row.fit_p_value)
        for old, row in zip(old_dwells, dwells, strict=True)
    ]
    write_dwells(empty_folder.dwells, tested)
    text = page_of(empty_folder).text
    assert "so it does not apply to these dwells" in text
    assert "Comparison of the estimators" not in text
    assert "Goodness of fit" in text


def test_dwells_solved_together_and_noise_have_their_sections(page):
    for words in (
        "Joint solution of each plateau",
        "level gyros by 10.0 % and of vertical gyros by 10.0 %",
        "Over all plateaus the half-difference is (+2.10 ± 0.30)",
        "1 62 6 +24.0 ± 1.8 -15.5 ± 1.8 +8.1 ± 5.8 +0.30 ± 0.80 +2.10 ± 0.30 0.400",
        "all 71",
        "Noise of the INS Allan deviation of the rates and accelerations at rest",
    ):
        assert words in page.text
    assert (
        page.text.index("Comparison of the estimators")
        < page.text.index("Goodness of fit")
        < page.text.index("Noise of the INS")
        < page.text.index("Joint solution of each plateau")
        < page.text.index("Dwells Bias ± standard uncertainty")
    )


def test_noise_is_held_against_what_the_station_declares(empty_folder, run_folder):
    shutil.copy(run_folder.noise, empty_folder.noise)
    shutil.copy(find_document("stations", "emulated"), empty_folder.station)
    page = page_of(empty_folder)
    assert re.search(r"velocity random walk (19|20)\.\d+ ± \d", page.text)
    assert "declared 5 µg/sqrt(Hz): larger than declared" in page.text
    assert "declares no noise" not in page.text
    assert len(page.loads) == 1
    assert (empty_folder.figures / "noise.png").exists()


def test_damaged_results_are_named_and_leave_their_sections_out(empty_folder, run_folder):
    for path in (run_folder.dwells, run_folder.joint_biases):
        shutil.copy(path, empty_folder.path)
    empty_folder.joint.write_text("stop\n1\n", encoding="utf-8")
    empty_folder.noise.write_text("{", encoding="utf-8")
    text = text_of(empty_folder)
    assert "joint.csv can't be used:" in text
    assert "noise.json can't be used:" in text
    assert "Joint solution of each plateau" not in text
    assert "Noise of the INS" not in text


@pytest.mark.draws
def test_a_figure_is_freed_before_the_next_one_is_drawn(empty_folder):
    drawn = []

    def draw():
        assert all(each() is None for each in drawn)
        figure = new_figure(2.0)
        drawn.append(weakref.ref(figure))
        return figure

    section = Section("", figures=[SectionFigure(name, "", draw) for name in ("first", "second", "third")])
    with_figure_files(empty_folder.path, [section], "")
    assert len(drawn) == 3


def test_sections_stand_before_the_dwells(empty_folder, dwells, bins):
    write_dwells(empty_folder.dwells, dwells)
    drawn = SectionFigure("made_up", "the caption", lambda: bias_figure("x", dwells, bins))
    section = Section(
        "One bias for all positions",
        ["What <follows> is made up."],
        [drawn],
        [SectionTable("its caption", ["temperature / °C", "X gyro"], [["72", "1.0 ± 0.2"]])],
    )
    sections = with_figure_files(empty_folder.path, [section], "")
    page = page_with("".join(render(read_run(empty_folder), [], sections)))
    assert (
        "One bias for all positions What <follows> is made up. the caption its caption "
        "temperature / °C X gyro 72 1.0 ± 0.2 Dwells Bias" in page.text
    )
    assert len(page.loads) == 1


def test_single_position_without_a_dwell_in_a_bin_is_empty(empty_folder, dwells):
    two = [row for row in dwells if row.position in ("y_up", "z_up")]
    write_dwells(empty_folder.dwells, [row for row in two if row.position == "z_up" or row.chamber_c < 60.0])
    text = text_of(empty_folder)
    assert text.count("empty") - text.count("empty in all positions") == 3


def test_flagged_dwell_is_marked_with_its_reason_as_text(page):
    assert "flagged: the INS left navigation during the dwell; chamber <door> open" in page.text
    assert "door" not in page.tags


def test_durations_and_safe_state_are_there(page):
    assert "chamber 1 0:40:00 0:49:10 +0:09:10 (+22.9 %)" in page.text
    assert "ask operator 1 0:01:00 0:00:05" in page.text
    assert "all 5 0:53:00 1:01:27" in page.text
    assert "rate table stopped chamber switched off" in page.text
    assert "not fully reached" not in page.text


def test_equal_runs_give_equal_reports(page, run_folder):
    first = run_folder.report.read_bytes()
    assert write_report(run_folder).path.read_bytes() == first


@pytest.mark.draws
def test_figures_are_drawn_again_for_another_watermark(empty_folder, dwells):
    write_dwells(empty_folder.dwells, dwells[:1])
    write_report(empty_folder)
    unmarked = (empty_folder.figures / "temperature.png").read_bytes()
    empty_folder.provenance.write_text('{"options": {"world": "gyro_a"}}', encoding="utf-8")
    assert write_report(empty_folder).content.watermark
    assert (empty_folder.figures / "temperature.png").read_bytes() != unmarked


def test_run_whose_positions_agree_says_so(empty_folder, equal_dwells):
    write_dwells(empty_folder.dwells, equal_dwells)
    BIAS_BINS_TABLE.write(empty_folder.bias_bins, bin_biases(equal_dwells))
    assert text_of(empty_folder).count("No significant difference between positions") == 3


def test_failed_run_states_reason_step_and_unsafe_outputs(empty_folder, journal_writer):
    journal_writer(empty_folder, ended="failed", reason="chamber: no <reply>", problem="table: no reply")
    text = text_of(empty_folder)
    assert (
        "The run failed. chamber: no <reply> Unfinished step: 6, turn 180 deg (cycle 1, 62 degC, z_up)."
        in text
    )
    assert "The safe state was not fully reached" in text
    assert "rate table stopped: failed: table: no reply" in text
    assert "No dwell was measured." in text
    assert "No dwell gave a bias" in text
    assert "dwells.csv is missing." in text


def test_run_of_calibration_checks_is_no_failure(empty_folder, run_folder, journal_writer):
    journal_writer(empty_folder)
    shutil.copytree(run_folder.telemetry, empty_folder.telemetry)
    CALIBRATION_CHECK_TABLE.write(empty_folder.calibration_check, [ROW, ALIGNMENT])
    page = page_of(empty_folder)
    assert "Gyro bias of unit U7" in page.text
    assert "dwells 2 dwells for the calibration check" in page.text
    assert "Results All 2 biases agree with the calibration" in page.text
    assert "Dwells 2 dwells for the calibration check, without a turn" in page.text
    assert "Temperatures over the run. Calibration check" in page.text
    for words in ("No dwell", "dwells.csv is missing", "Bands and bars"):
        assert words not in page.text
    assert len(page.loads) == 1


def test_unit_is_known_from_the_journal_before_anything_is_measured(empty_folder):
    with Journal(empty_folder.journal, VirtualClock()) as journal:
        journal.record("ins_identified", unit="1007", identity="made-up INS")
    assert "Gyro bias of unit 1007" in text_of(empty_folder)


def test_run_in_one_position_says_once_that_there_is_nothing_to_compare(empty_folder, dwells):
    write_dwells(empty_folder.dwells, [row for row in dwells if row.position == "y_up"])
    text = text_of(empty_folder)
    assert text.count("Nothing to compare") == 1


def test_a_dwell_that_was_skipped_is_counted_on_the_first_page(empty_folder, dwells):
    write_dwells(empty_folder.dwells, dwells[:1])
    with Journal(empty_folder.journal, VirtualClock()) as journal:
        for dwell in (dwells[0].dwell, 70, 71):  # the first was resumed and measured after all
            journal.record("dwell_skipped", dwell=dwell)
    assert "1 measured, 0 of them flagged; 2 skipped" in page_of(empty_folder).text


def test_killed_run_is_reported_as_such(empty_folder, journal_writer):
    journal_writer(empty_folder, ended="")
    text = text_of(empty_folder)
    assert "The run has not ended. It was killed or is still running" in text
    assert "The journal has no safe state." in text


def test_empty_folder_still_gives_a_report(empty_folder):
    page = page_of(empty_folder)
    assert "serial number unknown" in page.text
    assert page.loads == []
    assert "No step was finished." in page.text


def test_dwells_that_are_all_flagged_still_give_a_report(empty_folder, dwells):
    write_dwells(empty_folder.dwells, [row for row in dwells if row.flags])
    page = page_of(empty_folder)
    assert "1 measured, 1 of them flagged" in page.text
    assert len(page.loads) == 1


def test_data_that_can_not_be_hashed_are_reported(copy):
    (copy.can / "part-00001.blf").mkdir(parents=True)
    text = page_of(copy).text
    assert "The data can't be hashed" in text
    assert "Data of this report" not in text


@pytest.mark.draws
def test_figures_are_drawn_again_only_if_what_they_show_has_changed(empty_folder, dwells):
    write_dwells(empty_folder.dwells, dwells[:8])
    BIAS_BINS_TABLE.write(empty_folder.bias_bins, bin_biases(dwells[:8]))
    write_report(empty_folder)
    drawn = {path: path.stat().st_mtime_ns for path in empty_folder.figures.glob("*.png")}
    write_report(empty_folder)
    assert len(drawn) > 4
    assert {path: path.stat().st_mtime_ns for path in drawn} == drawn
    write_dwells(empty_folder.dwells, [replace(dwells[0], cycle=dwells[0].cycle + 1), *dwells[1:8]])
    write_report(empty_folder)
    assert all(path.stat().st_mtime_ns > at_ns for path, at_ns in drawn.items())
