import itertools
import json
import math
import os
import re
import threading
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from gyrobench.bench.monitor.page_content import Freshness
from gyrobench.bench.monitor.snapshot import MeasuredProfile, Note, PlannedProfile, Question, RunState
from gyrobench.bench.monitor.website import Website, full_page, run_fragment
from tests.bench.monitor.sample_snapshots import made_up_snapshot, new_snapshot, waiting_snapshot
from tests.bench.monitor.served_run import ask, now, run_under_way, served, write_snapshot


def text_of(site, target):
    answer = site.answer(target)
    assert answer.status == 200
    return answer.body.decode()


def test_the_page_of_a_run_holds_what_it_refreshes(tmp_path):
    with run_under_way(tmp_path / "mine") as run:
        site = Website(run, now)
        page, fragment = text_of(site, "/"), text_of(site, "/fragment")
    assert fragment in page
    assert "running" in fragment
    assert page.startswith("<!DOCTYPE html>")
    assert '<noscript><meta http-equiv="refresh" content="10"></noscript>' in page


def test_pages_of_an_emulated_run_say_so(tmp_path):
    for name, options in (("emulated", {"world": "quick"}), ("real", {})):
        write_snapshot(tmp_path / name)
        (tmp_path / name / "provenance.json").write_text(json.dumps({"options": options}))
    site = Website(tmp_path, now)
    assert "SIMULATED:" in text_of(site, "/runs/emulated/")
    assert "SIMULATED" not in text_of(site, "/runs/real/")
    assert text_of(site, "/").count("SIMULATED, ") == 1


def test_the_policy_lets_in_nothing_but_the_style_and_the_script_of_the_page(tmp_path):
    write_snapshot(tmp_path / "mine")
    one, other = (Website(tmp_path / "mine", now).answer("/") for _ in range(2))
    rules = dict(rule.split(" ", 1) for rule in one.policy.split("; "))
    nonce = rules["script-src"].removeprefix("'nonce-").removesuffix("'")
    assert rules["default-src"] == "'none'"
    assert rules["style-src"] == rules["script-src"]
    assert rules["connect-src"] == "'self'"
    assert one.body.decode().count(f'nonce="{nonce}"') == 2
    assert nonce not in other.policy


@pytest.mark.parametrize(
    "target",
    [
        "/station.yaml", "/live.json", "/journal.jsonl", "/can/", "/figures", "/.lock",
        "/../mine/report.html", "/..%2fmine%2freport.html", "/%2e%2e/mine/", "//etc/passwd", "/etc/passwd",
        "/report.html/", "/report.html/..", "/closure/closure.html", "/runs/mine/", "/fragment/", "/%00",
    ],
)  # fmt: skip
def test_only_the_pages_of_a_run_have_addresses(tmp_path, target):
    run = tmp_path / "mine"
    write_snapshot(run)
    for name in ("station.yaml", "report.html"):
        (run / name).write_text("content")
    assert Website(run, now).answer(target).status == 404


@pytest.mark.parametrize("target", ["/%ff%fe", "/\x00"])
def test_an_address_that_is_none_is_refused(tmp_path, target):
    assert Website(tmp_path, now).answer(target).status in (400, 404)


def test_what_a_run_left_is_shown_without_its_scripts(tmp_path):
    run = tmp_path / "mine"
    write_snapshot(run, state=RunState.FINISHED)
    site = Website(run, now)
    assert "report.html" not in text_of(site, "/")
    (run / "report.html").write_text("<p>the report</p>")
    (run / "closure").mkdir()
    (run / "closure" / "closure.html").write_text("<p>the search</p>")
    assert '<a id="record-1" href="report.html">Report</a>' in text_of(site, "/")
    assert text_of(site, "/report.html") == "<p>the report</p>"
    assert text_of(site, "/closure/closure.html") == "<p>the search</p>"
    policy = site.answer("/report.html").policy
    assert "script-src" not in policy
    assert "sandbox" in policy


def test_a_report_that_is_a_link_out_of_the_run_folder_is_not_there(tmp_path):
    run = tmp_path / "mine"
    write_snapshot(run)
    secret = tmp_path / "secret"
    secret.write_text("secret")
    (run / "report.html").symlink_to(secret)
    assert Website(run, now).answer("/report.html").status == 404


def test_a_report_beyond_all_size_is_refused(tmp_path):
    run = tmp_path / "mine"
    write_snapshot(run)
    with (run / "report.html").open("wb") as stream:
        stream.truncate(60_000_000)
    assert Website(run, now).answer("/report.html").status == 503


def test_a_folder_of_runs_lists_those_under_way_and_then_the_newest(tmp_path):
    for age_s, name in enumerate(("new", "older", "under_way")):
        write_snapshot(tmp_path / name, state=RunState.FINISHED)
        began = tmp_path / name / "procedure.yaml"
        began.touch()
        os.utime(began, (1e9 - age_s, 1e9 - age_s))
    (tmp_path / "no_run").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "new")
    with run_under_way(tmp_path / "under_way"):
        page = text_of(Website(tmp_path, now), "/")
    places = [page.index(f'href="runs/{name}/"') for name in ("under_way", "new", "older")]
    assert places == sorted(places)
    assert page.count("<li") == 3
    assert page.count("finished") == 2


def test_each_run_of_a_folder_has_its_page_with_a_way_back(tmp_path):
    write_snapshot(tmp_path / "mine")
    (tmp_path / "mine" / "report.html").write_text("the report")
    site = Website(tmp_path, now)
    assert 'href="../../"' in text_of(site, "/runs/mine/")
    assert "<main" in text_of(site, "/runs/mine/fragment")
    assert text_of(site, "/runs/mine/report.html") == "the report"
    assert site.answer("/runs/mine").headers == {"Location": "/runs/mine/"}


@pytest.mark.parametrize("target", ["/runs/other/", "/runs/", "/runs/../", "/runs/../mine/", "/runs/%2e%2e/"])
def test_a_run_that_is_not_in_the_folder_has_no_page(tmp_path, target):
    write_snapshot(tmp_path / "mine")
    assert Website(tmp_path, now).answer(target).status == 404


def test_a_run_that_begins_later_gets_its_page_at_the_same_address(tmp_path):
    site = Website(tmp_path, now)
    assert "No run in this folder yet" in text_of(site, "/")
    with run_under_way(tmp_path):
        assert "running" in text_of(site, "/")


def test_names_and_messages_are_text_of_any_content(tmp_path):
    name = "<img src=x onerror=alert(1)>&\"'?#%41"
    write_snapshot(tmp_path / name, messages=(Note(0.0, "<script>alert(1)</script>"),))
    site = Website(tmp_path, now)
    listed = text_of(site, "/fragment")
    address = "/runs/%3Cimg%20src%3Dx%20onerror%3Dalert%281%29%3E%26%22%27%3F%23%2541/"
    page = text_of(site, f"{address}fragment")
    assert f'href="{address.removeprefix("/")}"' in listed
    for text in (listed, page):
        assert "<img" not in text
        assert "<script" not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in page


def test_a_killed_run_is_shown_at_once(tmp_path):
    run = tmp_path / "mine"
    site = Website(run, now)
    with run_under_way(run):
        assert "running" in text_of(site, "/fragment")
    assert "stopped without recording its end" in text_of(site, "/fragment")
    assert "gyrobench resume runs/six_position-001 --look" in text_of(site, "/fragment")
    assert "commands are sent" not in text_of(site, "/fragment")
    assert "stopped without recording its end" in text_of(Website(tmp_path, now), "/fragment")


def test_alarms_at_the_kill_of_a_run_are_shown(tmp_path):
    with run_under_way(tmp_path, waiting_snapshot()):
        pass
    shown = text_of(Website(tmp_path, now), "/fragment")
    assert "stopped without recording its end" in shown
    assert "ALARM chamber deviation at the end" in shown


def test_a_run_that_has_fallen_silent_is_reported(tmp_path):
    with run_under_way(tmp_path / "mine", age_s=40.0) as run:
        alone = text_of(Website(run, now), "/fragment")
        assert "No update for 40 s" in alone
        assert "last heard running" in alone
        assert "No update for 40 s" in text_of(Website(tmp_path, now), "/fragment")


@pytest.mark.parametrize("kept", [0.0, 0.3, 0.999])
def test_a_damaged_snapshot_gives_way_to_what_else_the_run_left(tmp_path, kept):
    run = tmp_path / "mine"
    write_snapshot(run)
    whole = (run / "live.json").read_bytes()
    (run / "live.json").write_bytes(whole[: int(kept * len(whole))])
    (run / "journal.jsonl").write_text('{"time_s": 7200.0, "event": "run_ended", "ended": "finished"}\n')
    for site, target in (
        (Website(run, now), "/"),
        (Website(tmp_path, now), "/"),
        (Website(tmp_path, now), "/runs/mine/"),
    ):
        assert "mine" in text_of(site, target)
        assert "Traceback" not in text_of(site, target)


def test_a_folder_that_holds_nothing_to_read_is_shown_with_its_file(tmp_path):
    run = tmp_path / "mine"
    run.mkdir()
    (run / "live.json").write_text("{")
    assert "journal.jsonl" in text_of(Website(run, now), "/")
    assert "can&#39;t be read" in text_of(Website(tmp_path, now), "/")


def test_a_reader_while_the_snapshot_is_written_sees_a_whole_one(tmp_path):
    done = threading.Event()
    seen = []
    with run_under_way(tmp_path / "mine") as run, served(run) as server:

        def write():
            for number in range(1, 60):
                write_snapshot(run, made_up_snapshot(), unit=f"unit-{number}")
            done.set()

        write_snapshot(run, made_up_snapshot(), unit="unit-0")
        writer = threading.Thread(target=write)
        writer.start()
        while not done.is_set():
            seen.append(ask(server, "/fragment")[1].decode())
        writer.join()
        seen.append(ask(server, "/fragment")[1].decode())
    assert all("unit unit-" in text and "</main>" in text for text in seen)
    assert "unit unit-59" in seen[-1]


FRESH = Freshness(1.0, False, "")
OVER = Freshness(0.0, True, "")
SNAPSHOTS = {
    "running": (made_up_snapshot(), FRESH),
    "waiting": (waiting_snapshot(), FRESH),
    "finished": (replace(made_up_snapshot(), state=RunState.FINISHED), OVER),
    "empty": (new_snapshot(), FRESH),
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


@pytest.fixture(params=SNAPSHOTS)
def page(request):
    return full_page(run_fragment(*SNAPSHOTS[request.param], {}, ""), "nonce")


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
    page = run_fragment(*SNAPSHOTS["waiting"], {}, "")
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
    running = run_fragment(*SNAPSHOTS["running"], {}, "")
    finished = run_fragment(*SNAPSHOTS["finished"], {"report.html": "Report"}, "")
    assert '<td class="whole">Z-Up</td>' in running
    assert "Live bias of the X gyro" in running
    assert "Step 212 of 325: navigate 10 min (cycle 1, -10 degC, Z-Down)" in running
    snapshot, *others = SNAPSHOTS["running"]
    returning = replace(snapshot, step=replace(snapshot.step, is_return=True))
    assert "Returning to step 212 of 325: " in run_fragment(returning, *others, {}, "")
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
