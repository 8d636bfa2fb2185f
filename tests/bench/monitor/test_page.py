import itertools
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from gyrobench.bench.monitor.page_content import Freshness
from gyrobench.bench.monitor.snapshot import MeasuredProfile, PlannedProfile, Question, RunSnapshot, RunState
from gyrobench.bench.monitor.website import full_page, run_fragment
from tests.bench.monitor.sample_snapshots import made_up_snapshot, waiting_snapshot

FRESH = Freshness(1.0, False, "")
OVER = Freshness(0.0, True, "")
EMPTY = RunSnapshot(
    name="mine", folder="runs/mine", procedure="", station="", unit="", started_utc="", updated_utc="",
    state=RunState.STARTING, now_s=0.0, left_s=0.0, planned_s=0.0, dwell_count=0,
)  # fmt: skip
PICTURES = {
    "running": (made_up_snapshot(), FRESH),
    "waiting": (waiting_snapshot(), FRESH),
    "finished": (replace(made_up_snapshot(), state=RunState.FINISHED), OVER),
    "empty": (EMPTY, FRESH),
    "silent INS": (
        replace(
            made_up_snapshot(),
            bench=replace(made_up_snapshot().bench, gyro_c=(math.nan,) * 3, case_c=math.nan),
        ),
        FRESH,
    ),
    "no plan": (replace(made_up_snapshot(), planned=PlannedProfile(), measured=MeasuredProfile()), FRESH),
}


class Outline(HTMLParser):
    """Checks that elements are closed in order, and gathers what they are."""

    VOID = frozenset({"meta", "br", "link", "img", "input"})

    def __init__(self, page):
        super().__init__()
        self.open, self.elements = [], []
        self.feed(page)
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(params=PICTURES)
def page(request):
    return full_page(run_fragment(*PICTURES[request.param], {}, ""), "nonce")


def test_every_page_is_well_formed_with_one_name_for_each_part(page):
    elements = Outline(page).elements
    names = [attributes["id"] for _, attributes in elements if "id" in attributes]
    assert len(names) == len(set(names))
    labels = [attributes.get("aria-labelledby") for _, attributes in elements]
    assert {label for label in labels if label} <= set(names)


def test_nothing_comes_from_outside_and_no_style_is_in_line(page):
    for tag, attributes in Outline(page).elements:
        assert not {"style", "src", "onclick", "onload"} & attributes.keys(), tag
        assert "//" not in attributes.get("href", "")


def test_headings_go_down_one_step_at_a_time_and_tables_have_heads(page):
    elements = Outline(page).elements
    levels = [int(tag[1]) for tag, _ in elements if re.fullmatch("h[1-6]", tag)]
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in itertools.pairwise(levels))
    assert all("scope" in attributes for tag, attributes in elements if tag == "th")
    snapshots = [attributes for tag, attributes in elements if tag == "svg"]
    assert all("aria-label" in each or "aria-hidden" in each or "viewbox" in each for each in snapshots)


def test_no_number_that_is_not_known_gets_onto_the_page(page):
    assert not re.search(r"\b(nan|None|inf)\b", page.partition("<script")[0])


def test_state_time_left_temperature_dwell_and_alarms_come_first():
    page = run_fragment(*PICTURES["waiting"], {}, "")
    order = ["waiting for the operator", "ALARM chamber deviation", "6:00 h", "−9.8 °C", "13 of 24", "<h2"]
    places = [page.index(text) for text in order]
    assert places == sorted(places)
    assert "Answers: continue, abort." in page


def test_a_long_question_is_cut_and_whole_on_demand():
    text = "The run holds: " + "the sensor is silent; " * 40
    snapshot = replace(waiting_snapshot(), question=Question(text, ("continue", "abort")))
    page = run_fragment(snapshot, FRESH, {}, "")
    shown, _, rest = page.partition("<details")
    assert text not in shown
    assert "The run holds: the sensor is silent" in shown
    assert text in rest


def test_a_run_under_way_shows_its_dwell_and_one_that_is_over_what_it_left():
    running = run_fragment(*PICTURES["running"], {}, "")
    finished = run_fragment(*PICTURES["finished"], {"report.html": "Report"}, "")
    assert "Live bias of the X gyro" in running
    assert "Step 212 of 325: navigate 10 min (cycle 1, -10 degC, Z-Down)" in running
    assert "Live bias" not in finished
    assert '<a id="record-1" href="report.html">Report</a>' in finished


@pytest.mark.parametrize(
    ("snapshot", "freshness", "title"),
    [
        (made_up_snapshot(), FRESH, "running, 6:00 h left: six_position-001"),
        (waiting_snapshot(), FRESH, "▲ ALARM: six_position-001"),
        (made_up_snapshot(), Freshness(40.0, False, "No freshness"), "▲ silent: six_position-001"),
        (replace(waiting_snapshot(), state=RunState.FAILED), OVER, "failed: six_position-001"),
    ],
)
def test_the_title_reports_what_matters_most(snapshot, freshness, title):
    assert f'data-title="{title}"' in run_fragment(snapshot, freshness, {}, "")
